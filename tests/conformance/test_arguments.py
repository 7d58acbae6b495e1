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
    f"{value.__module__}.{value.__qualname__}": value
    for module in (wp, *MODULES)
    for value in (getattr(module, name) for name in getattr(module, "__all__", ()))
    if callable(value)
}


def doors():
    """What users call by name: functions, classes and their own public methods."""
    for name, value in PUBLIC.items():
        if not isinstance(value, type):
            yield name, value
        else:
            for own, method in {**vars(value), "__init__": value.__init__}.items():
                method = getattr(method, "__func__", method)
                if inspect.isfunction(method) and (own == "__init__" or own[0] != "_"):
                    yield f"{name}.{own}", method


TYPED = {name: call.__wrapped__ for name, call in doors() if hasattr(call, "__wrapped__")}
LEARNS = torch.ones((), requires_grad=True)
WRONG = {
    float: ("a", np.nan, 1e300, 1j, [1.0, 2.0], LEARNS),
    int: ("a", np.nan, 1.5, True, [1, 2], LEARNS),
    bool: ("no", 1, 0.0),
    str: (5, ["a"]),
    os.PathLike: (5, 1.5),
    np.ndarray: ("a", [None], {}),
    Mapping: ([], "a"),
    dict: ([], "a"),
}


BEYOND = {"a number > 0": 0.0, "a number ≥ 0": -1.0, "a number between 0 and 1": 1.0,
          "a whole number ≥ 1": 0, "a whole number ≥ 0": -1}  # fmt: skip
UNTYPED = {"load_mpi_library", "fit", "solve", "simulate"}
"""Without arguments, or whose options are checked where they are taken."""


def test_arguments_of_another_kind_are_refused_by_name():
    for call in filter(kinds_of, TYPED.values()):
        for argument, (kinds, default, bound) in kinds_of(call).items():
            wrong = WRONG.get(kinds[0], ("a", 5, LEARNS) if kinds[0] not in (tuple, list) else (5,))
            beyond = () if bound is None else (BEYOND.get(bound.words, "none of them"),)
            for value in (*wrong, *beyond):
                if any(isinstance(value, kind) for kind in kinds[1:]) or value is default:
                    continue
                with pytest.raises(wp.InputError, match=f"^{argument}: expected"):
                    check_arguments(call, {argument: value})
            check_arguments(call, {argument: default})


def test_every_function_that_users_call_is_typed_and_calls_go_through_the_door():
    functions = {name for name, value in PUBLIC.items() if not isinstance(value, type)}
    assert {name.split(".")[-1] for name in functions - {*TYPED}} <= UNTYPED
    assert len(TYPED) > 230
    for call in (
        lambda: wp.LPS("a"),
        lambda: wp.LPS(0.0),
        lambda: wp.Points.sheet((4, 4), np.nan),
        lambda: wp.Points.disk(20.0, 5.0, -1.0),
        lambda: wp.load(5),
        lambda: wp.certify(None, spacing="a"),
    ):
        with pytest.raises(wp.InputError, match="^(horizon|spacing|path): expected"):
            call()
