"""The types of the public face, as a user's own check sees them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import warp_peri
from warp_peri.solvers.linear import METHODS

ROOT = Path(__file__).parent.parent.parent
SCRIPT = Path(__file__).with_name("typed_use.py").read_text()
slow = pytest.mark.slow  # mypy reads torch, NumPy and Warp: about 12 s


@pytest.fixture(scope="module")
def complaints(tmp_path_factory):
    """What `mypy --strict` says of a script that stands outside the checkout."""
    pytest.importorskip("mypy")
    folder = tmp_path_factory.mktemp("user")

    def messages(script):
        (folder / "script.py").write_text(script)
        options = ("--strict", "--config-file=", "--follow-imports=silent", "--no-error-summary")
        answer = subprocess.run(
            [sys.executable, "-m", "mypy", *options, "script.py"],
            cwd=folder,
            env=os.environ | {"MYPYPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert answer.returncode in (0, 1), answer.stderr
        return answer.stdout

    return messages


def test_the_script_uses_every_public_name():
    assert set(warp_peri.__all__) <= set(re.findall(r"\bwarp_peri\.(\w+)", SCRIPT))


@slow
def test_the_script_passes(complaints):
    assert complaints(SCRIPT) == ""


@slow
@pytest.mark.parametrize(
    ("right", "wrong", "message"),
    [
        ("warp_peri.load(folder", "warp_peri.laod(folder", 'Module has no attribute "laod"'),
        ("set_threads(1)", 'set_threads("1")', 'incompatible type "str"; expected "int"'),
        ("method, str)", "method, int)", 'Expression is of type "str", not "int"'),
        ("operator(tensor), torch.Tensor", "operator(tensor), np.ndarray", 'of type "Tensor"'),
        ("            HORIZON,\n            warp_peri.Bernstein(1),", "", "horizon"),
    ],
)
def test_a_mistake_is_seen(right, wrong, message, complaints):
    assert SCRIPT.count(right) >= 1
    assert message in complaints(SCRIPT.replace(right, wrong))


@slow
def test_the_script_runs(tmp_path):
    run = subprocess.run(
        [sys.executable, "tests/package/typed_use.py", tmp_path],
        cwd=ROOT,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    _, error, *_, method, refusal = run.stdout.splitlines()
    assert float(error) < 1e-6  # the model that made the data is found again
    assert method in METHODS
    assert "none.json" in refusal
