"""Every argument of every public function and class that has a plain kind, fed with other kinds."""

import inspect
import os
from collections.abc import Mapping

import numpy as np
import pytest
import torch

import warp_peri as wp
from warp_peri.points.arguments import check_arguments, kinds_of

MODULES = [getattr(wp, name) for name in dir(wp) if inspect.ismodule(getattr(wp, name))]
PUBLIC = {
    f"{value.__module__}.{value.__qualname__}": value.__init__ if isinstance(value, type) else value
    for module in (wp, *MODULES)
    for value in (getattr(module, name) for name in getattr(module, "__all__", ()))
    if callable(value)
}
TYPED = {name: call.__wrapped__ for name, call in PUBLIC.items() if hasattr(call, "__wrapped__")}
LEARNS = torch.ones((), requires_grad=True)
WRONG = {
    float: ("a", np.nan, 1e300, 1j, [1.0, 2.0], LEARNS),
    int: ("a", np.nan, 1.5, True, [1, 2], LEARNS),
    bool: ("no", 1, 0.0),
    str: (5, ["a"]),
    os.PathLike: (5, 1.5),
    Mapping: ([], "a"),
    dict: ([], "a"),
}


@pytest.mark.parametrize("name", TYPED)
def test_an_argument_of_another_kind_is_refused_by_name(name):
    for argument, (kinds, default) in kinds_of(TYPED[name]).items():
        wrong = WRONG.get(kinds[0], ("a", 5, LEARNS) if kinds[0] not in (tuple, list) else (5,))
        for value in wrong:
            if any(isinstance(value, kind) for kind in kinds[1:]) or value is default:
                continue
            with pytest.raises(wp.InputError, match=f"^{argument}: expected"):
                check_arguments(TYPED[name], {argument: value})
        check_arguments(TYPED[name], {argument: default})


def test_most_of_what_users_call_is_typed_and_calls_go_through_the_door():
    assert len(TYPED) > 70
    for call in (
        lambda: wp.LPS("a"),
        lambda: wp.Points.sheet((4, 4), np.nan),
        lambda: wp.load(5),
        lambda: wp.certify(None, spacing="a"),
    ):
        with pytest.raises(wp.InputError, match="^(horizon|spacing|path): expected"):
            call()
