"""What cost a new user an hour each: told in one sentence, or done as was meant."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from itertools import takewhile

import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import kernel, lattice, manufactured, noise
from tests.support.solving import solve
from warp_peri import Bernstein, Dataset, InputError, Model, evaluate
from warp_peri.atoms.dumps import dump_frames
from warp_peri.cli.main import main
from warp_peri.cli.train import in_percent
from warp_peri.errors import exit_status
from warp_peri.learning.fit import learn as fit
from warp_peri.materials.third_order import Smoothing
from warp_peri.methods import Conditions
from warp_peri.points.dataset import save_dataset
from warp_peri.points.families import families_of
from warp_peri.transfers import onto_lattice

HORIZON = 2.5
TRUE = kernel("positive", HORIZON)


@pytest.fixture(scope="module")
def samples():
    return manufactured(TRUE, lattice(4, HORIZON), 3)


@pytest.fixture(scope="module")
def result(samples):
    return fit(Dataset({"only": samples}, 3.35, 2200.0), HORIZON, Bernstein(2))


def test_a_data_set_with_one_obvious_set_is_taken(samples, result):
    data = Dataset({"train": samples, "val": samples}, 3.35, 2200.0)
    assert fit(data, HORIZON, Bernstein(2)).material.mu == result.material.mu
    numbers = evaluate(result.material, Dataset({"val": samples}, 3.35, 2200.0))
    assert numbers == evaluate(result.material, samples)
    with pytest.raises(InputError, match=r"a data set with train, val; name one, as data\['train'"):
        evaluate(result.material, data)


def test_a_fit_is_shown_in_a_few_lines(result):
    assert len(repr(result)) < 900
    assert len(str(result).splitlines()) < 12
    assert "certified on   1 Å" in repr(result)
    html = result._repr_html_()
    assert html.startswith("<table>")
    assert "<polyline" in html


def test_rounded_positions_are_refused_with_the_tolerance():
    points = lattice(4, HORIZON, spacing=1.2345678)
    rounded = replace(points, x=points.x.round(2))
    with pytest.raises(InputError, match=r"by up to 0\.0.* where 1e-06 Å \(1e-06 spacings\) are"):
        families_of(rounded, HORIZON)


@pytest.mark.parametrize("columns", ["xu yu z", "x y zu", "xu yu zs"])
def test_a_height_of_another_kind_is_no_matter(tmp_path, columns):
    head = (
        "ITEM: TIMESTEP\n0\nITEM: NUMBER OF ATOMS\n2\nITEM: BOX BOUNDS pp pp pp\n0 9\n0 9\n-1 1\n"
    )
    path = tmp_path / "a.dump"
    path.write_text(f"{head}ITEM: ATOMS id type {columns}\n2 1 3.5 4.5 0\n1 1 1.5 2.5 0\n")
    frame = next(dump_frames(path))
    assert frame.x == pytest.approx(np.array([[1.5, 2.5], [3.5, 4.5]]))
    path.write_text(f"{head}ITEM: ATOMS id type xu y zu\n2 1 3.5 4.5 0\n1 1 1.5 2.5 0\n")
    with pytest.raises(InputError, match="expected x and y of one kind, as xu yu"):
        next(dump_frames(path))


def test_numbers_beyond_all_data_are_refused(samples):
    with pytest.raises(InputError, match=r"u: expected values below 1e\+100, got"):
        replace(samples, u=1e200 * samples.u)
    with pytest.raises(InputError, match=r"mu: expected a finite number up to 1e\+100"):
        Model(0.3, 1e308, 1.0, [1.0], 3.0)


@pytest.mark.parametrize("size", [1e-200, 1e90])
def test_conjugate_gradients_take_loads_of_any_size(samples, size):
    zero, load = np.zeros_like(samples.u[0]), noise(samples)
    by = [solve(TRUE, samples, size * load, zero, method=name) for name in ("cg", "lu")]
    assert by[0] / size == pytest.approx(by[1] / size, abs=1e-6 * np.abs(by[1]).max() / size)


def test_a_file_cannot_write_to_the_terminal(samples, tmp_path, capsys):
    path = tmp_path / "data.h5"
    evil = {"note": "\x1b[31mred\x1b[2J", "\x1b]0;title\x07": 1}
    save_dataset(path, Dataset({"a\x1b[1m": samples}, 3.35, 2200.0, evil))
    assert main(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "\x07" not in out
    assert "red" in out


def command(*words):
    """A process of the command, its streams in hand."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-m", "warp_peri", *words], **pipes)


RINGS = """
import os, runpy, signal, sys

if not {ignored}:  # whatever the process that runs the tests was given, as by a shell's `&`
    signal.signal(signal.SIGINT, signal.default_int_handler)

class Rings:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Rings())
sys.argv = ["warp-peri", "certify", "no such model"]
runpy.run_module("warp_peri", run_name="__main__")
"""


@pytest.mark.skipif(os.name == "nt", reason="signals")
@pytest.mark.parametrize("module", ["warp_peri.cli.main", "numpy", "datetime", "h5py"])
def test_an_early_interrupt_is_no_traceback(module):
    words = [sys.executable, "-c", RINGS.format(module=module, ignored=False)]
    process = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert process.returncode == 130
    assert process.stderr == "interrupted; nothing is kept yet\n"


@pytest.mark.skipif(os.name == "nt", reason="signals")
def test_an_interrupt_that_the_shell_ignores_stays_ignored():
    ignoring = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
    words = [sys.executable, "-c", ignoring + RINGS.format(module="numpy", ignored=True)]
    process = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False)
    assert process.returncode == 2
    assert "no such file" in process.stderr


def test_commands_end_with_one_status_and_one_line(capsys):
    def failing(error):
        def work():
            raise error

        return work

    for work, status, words in (
        (lambda: None, 0, ""),
        (lambda: 2, 2, ""),
        (failing(KeyboardInterrupt()), 130, "interrupted; all is kept\n"),
        (failing(InputError("x: expected 1")), 2, "tool: error: x: expected 1\n"),
        (failing(OSError("disk\n  full")), 1, "tool: error: disk full\n"),
    ):
        assert exit_status(work, "all is kept", name="tool") == status
        assert capsys.readouterr().err == words
    with pytest.raises(KeyError):  # a fault of the program is not hidden
        exit_status(failing(KeyError("x")))


def errors_of(words, capsys):
    """What the command refuses with, in its own words."""
    assert main(list(map(str, words))) == 2
    return capsys.readouterr().err


@pytest.mark.parametrize(
    ("horizon", "words"),
    [
        ("1e9", "horizon: expected at most 100 spacings (1e+06), got 1000000000.0"),
        ("9e4", "have not at horizon 90000 Å; the largest that fits is 28284.3 Å"),
        ("inf", "horizon: expected a number > 0, got inf"),
    ],
)
def test_a_fit_refuses_in_the_numbers_it_was_given(horizon, words, samples, tmp_path, capsys):
    large = replace(samples, points=replace(samples.points, x=1e4 * samples.x, spacing=1e4))
    save_dataset(tmp_path / "d.h5", Dataset({"train": large}, 3.35, 2200.0))
    asked = ["train", tmp_path / "d.h5", "--out", tmp_path / "o", "--horizon", horizon]
    assert words in errors_of(asked, capsys)


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="a folder that takes no files")
def test_a_folder_that_takes_no_files_is_no_other_job(samples, result, tmp_path, capsys):
    save_dataset(tmp_path / "d.h5", Dataset({"train": samples}, 3.35, 2200.0))
    result.material.save(tmp_path / "model.json")
    for words in (
        ["train", tmp_path / "d.h5", "--out", "/proc/xx", "--horizon", HORIZON],
        ["train", tmp_path / "d.h5", "--out", "/proc/xx/y", "--horizon", HORIZON],
        [
            "export",
            tmp_path / "model.json",
            tmp_path / "d.h5",
            "--set",
            "train",
            "--out",
            "/proc/xx",
        ],
    ):
        said = errors_of(words, capsys)
        assert f"error: {words[words.index('--out') + 1]}: cannot be written (No such" in said


def test_help_gives_switches_no_default(capsys):
    with pytest.raises(SystemExit):
        main(["evaluate", "--help"])
    assert "(default: True)" not in capsys.readouterr().out


def test_training_prints_errors_in_percent_as_evaluate_does(samples, tmp_path, capsys):
    many = manufactured(TRUE, samples.points, 8)
    save_dataset(tmp_path / "d.h5", Dataset({"train": many}, 3.35, 2200.0))
    words = ["train", tmp_path / "d.h5", "--out", tmp_path / "o", "--horizon", HORIZON]
    assert main([*map(str, words), "--degree", "2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert not any(line.startswith("not_evaluated") for line in lines)
    kept = json.loads((tmp_path / "o" / "metrics.json").read_text())
    printed = float(
        lines[lines.index("residual of forces, larger for short waves [%]:") + 1].split(":")[1]
    )
    assert printed == pytest.approx(100 * kept["E_res"]["train"], rel=1e-5)
    start = lines.index("shares of the squared residual [%]:")
    below = takewhile(lambda line: line.startswith(" "), lines[start + 1 :])
    shares = [float(line.split(":")[1]) for line in below]
    assert sum(shares) == pytest.approx(100.0, abs=0.01)
    assert not any(line.startswith("note") for line in lines)
    small = {"units": ("mm", "GPa"), "E_res": {"a": 0.51, "b": 0.05}, "E_u": {"a": 0.02, "b": 0.02}}
    assert in_percent(small)["note"].startswith("the loads of a are small for their displacement")


def test_a_model_that_is_not_in_angstrom_is_not_told_of_angstrom(samples):
    points = replace(samples.points, units=("mm", "GPa"))
    for call in (
        lambda: Smoothing(radius=0.0),
        lambda: Conditions(zeta=-1.0),
        lambda: families_of(replace(points, spacing=0.0), -1.0),
        lambda: onto_lattice(samples, spacing=0.0),
    ):
        with pytest.raises(InputError) as caught:
            call()
        assert "Å" not in str(caught.value)
        assert "TPa" not in str(caught.value)


def test_no_load_is_none():
    points = lattice(4, HORIZON, 1.0)
    model = replace(TRUE, certified_on=(1.0,))
    u = 1e-3 * points.x
    free, zero = (wp.solve(model, wp.Dirichlet(points, b, u)).u for b in (None, 0 * u))
    assert np.array_equal(free, zero)
