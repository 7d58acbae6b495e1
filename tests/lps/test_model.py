"""The model and its file."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.support import reference
from tests.support.problems import KERNELS, kernel
from warp_peri import InputError, Model

MODEL = replace(
    kernel("sign-changing", 20.0, spacing=5.0),
    certificate={"5": {"symbol_min": np.float64(0.1)}},
    provenance={"seed": 1},
)


@pytest.fixture
def path(tmp_path):
    """A good model in a file."""
    MODEL.save(tmp_path / "model.json")
    return tmp_path / "model.json"


def test_the_file_says_what_it_is(path):
    content = json.loads(path.read_text())
    assert {key: content[key] for key in ("format", "version", "length_unit", "stress_unit")} == {
        "format": "warp_peri.model",
        "version": 1,
        "length_unit": "angstrom",
        "stress_unit": "TPa",
    }
    assert content["degree"] == 4
    assert content["quadrature"] == {"degree": 5, "singularity": 3}


@pytest.mark.parametrize("name", KERNELS)
def test_influence_is_the_bernstein_sum(name):
    model = kernel(name, 3.0)
    r = np.array([0.1, 1.0, np.sqrt(2), 2.9, 3.0])
    expected = [reference.influence(value, 3.0, model.alpha, KERNELS[name]["D"]) for value in r]
    np.testing.assert_allclose(model.influence(r), expected, rtol=1e-13)


def test_continuum_constants_are_those_of_the_plane():
    model = Model(0.4, 0.8, 1.0, [1.0], 3.0)
    E, nu = model.E, model.nu
    assert E / (2 * (1 + nu)) == pytest.approx(0.8)  # μ
    assert E * nu / (1 - nu**2) == pytest.approx(0.4)  # λ in the plane


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alpha": 3.0}, "alpha: expected less than 3, got 3.0"),
        ({"alpha": np.nan}, "alpha: expected a finite number, got nan"),
        ({"horizon": 0.0}, "horizon: expected a number > 0, got 0.0"),
        ({"horizon": "20"}, "horizon: expected a number > 0, got '20'"),
        ({"mu": 0.0}, "expected μ > 0 and λ . μ > 0, got 0.3, 0.0"),
        ({"lam": -0.8}, "expected μ > 0 and λ . μ > 0, got -0.8, 0.8"),
        ({"lam": True}, "lam: expected a finite number, got True"),
        ({"mu": 10**400}, "mu: expected a finite number"),
        ({"D": []}, r"D: expected at least one coefficient \(degree ≥ 0\), got none"),
        ({"D": [0.0, 0.0]}, "D: expected a coefficient other than 0"),
        ({"D": [1.0, np.inf]}, "D: expected finite values, got inf"),
        ({"D": [1.0, None]}, "D: expected float values, got object"),
        ({"D": [True, 1.0]}, "D: expected finite numbers, got true or false"),
        ({"D": [[1.0, 2.0]]}, "D: expected a list of numbers, got lists"),
        ({"D": [[1.0], [2.0, 3.0]]}, "D: expected an array"),
        ({"certified_on": (5.0, np.nan)}, "certified_on: expected a finite number, got nan"),
    ],
)
def test_numbers_out_of_range_are_refused(change, words):
    given = {"lam": 0.3, "mu": 0.8, "alpha": 1.0, "D": [1.0], "horizon": 3.0}
    with pytest.raises(InputError, match=words):
        Model(**given | change)


BAD_FILES = {
    "format": ("format", "other", "format: expected one of .*warp_peri.model, .*got 'other'"),
    "length unit": ("length_unit", "mile", "length_unit: expected one of angstrom, .*got 'mile'"),
    "stress unit": ("stress_unit", "GPa", "sha256: the contents are not what was written"),
    "missing key": ("alpha", None, "missing keys: alpha"),
    "mu": ("mu", -0.8, "expected μ > 0"),
    "degree": ("degree", 3, "degree: expected 4, got 3"),
    "D short": ("D", [1.0], "degree: expected 0, got 4"),
    "another function": ("D_dilatation", [1.0], "unknown keys: D_dilatation"),
    "D nested": ("D", [[1.0], [1.0, 2.0]], "D: expected an array"),
    "quadrature": ("quadrature", {"degree": 3, "singularity": 3}, "quadrature: expected"),
    "spacings": ("certified_on", 5.0, "certified_on: expected a list, got 5.0"),
    "certificate": ("certificate", [], r"certificate: expected an object, got \[\]"),
}


@pytest.mark.parametrize(("key", "value", "words"), BAD_FILES.values(), ids=BAD_FILES)
def test_a_wrong_file_is_refused_by_name(path, key, value, words):
    content = json.loads(path.read_text())
    content[key] = value
    if value is None:
        del content[key]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=words) as caught:
        Model.load(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    "text", ["", "{", "[" * 100_000, '{"format": ', b"\xff\xfe\x00"], ids=range(5)
)
def test_what_is_no_json_is_refused(path, text):
    """Where a package has raised the limit of recursion too, as symfc does."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(100_000)
    try:
        with pytest.raises(InputError, match="not a readable JSON file"):
            Model.load(path)
    finally:
        sys.setrecursionlimit(limit)


def test_what_is_no_model_is_refused(tmp_path):
    with pytest.raises(InputError, match="nowhere.json: no such file"):
        Model.load(tmp_path / "nowhere.json")
    with pytest.raises(InputError, match="not a readable JSON file"):
        Model.load(tmp_path)
    (tmp_path / "list.json").write_text("[]")
    with pytest.raises(InputError, match="expected a JSON object, got list"):
        Model.load(tmp_path / "list.json")


def test_spacings_without_certificate_are_refused_or_warned_about():
    MODEL.check_spacing(5.0)
    MODEL.check_spacing(5.0 * (1 + 1e-9))
    with pytest.raises(InputError, match="certified on 5 Å, not on 2.5 Å"):
        MODEL.check_spacing(2.5)
    with pytest.warns(UserWarning, match="certified on 5 Å, not on 2.5 Å"):
        MODEL.check_spacing(2.5, allow_uncertified=True)
    with pytest.raises(InputError, match="certified on no spacing, not on 5 Å"):
        replace(MODEL, certified_on=()).check_spacing(5.0)


def test_a_file_that_names_no_units_is_in_angstrom_and_terapascal(path):
    content = json.loads(path.read_text())
    del content["length_unit"], content["stress_unit"], content["sha256"]
    path.write_text(json.dumps(content))
    with pytest.warns(UserWarning, match="names no units: taken as Å and TPa"):
        assert Model.load(path).units == ("angstrom", "TPa")


def test_units_that_lead_nowhere_are_refused(path):
    model = Model.load(path)
    with pytest.raises(InputError, match="no factor leads from"):
        model.in_units(("sigma", "epsilon/sigma^3"))
    with pytest.raises(InputError, match="length_unit: expected one of"):
        model.in_units(("mile", "TPa"))
    with pytest.raises(InputError, match=r"expected \(length, stress\), or .*, got 'nm'"):
        model.in_units("nm")
