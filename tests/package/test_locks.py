"""Two jobs on one output: the second is refused, and a dead job holds nothing."""

import subprocess
import sys
from pathlib import Path

import pytest

import tools.make_graphene as tool
from examples import train_graphene
from tests.support.jobs import problem
from warp_peri import Bernstein, InputError
from warp_peri.files.atomic import PART, locked, whole_file, write_text
from warp_peri.learning.fit import learn as fit
from warp_peri.methods import TwoStage, sweep

ROOT = Path(__file__).parent.parent.parent
HOLD = """
import sys
from contextlib import ExitStack
from warp_peri.files.atomic import locked
with ExitStack() as stack:
    for path in sys.argv[1:]:
        stack.enter_context(locked(path))
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def holder():
    """Starts processes that hold a path until they are killed."""
    started = []

    def hold(*paths):
        process = subprocess.Popen(
            [sys.executable, "-c", HOLD, *map(str, paths)],
            cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        started.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield hold
    for process in started:
        process.kill()
        process.communicate()


def refused():
    return pytest.raises(InputError, match="another job is writing here")


def test_a_held_output_is_refused_by_every_job(holder, tmp_path, capsys):
    holder(*(tmp_path / name for name in ("out", "g.h5", "state.npz")))
    with pytest.raises(InputError, match="out: another job is writing here"):
        sweep(problem(), problem(1), tmp_path / "out", horizons=(2.0,), degrees=(0,), jobs=1)
    assert tool.main(["--out", str(tmp_path / "g.h5"), "--quiet"]) == 2
    assert "g.h5: another job is writing here" in capsys.readouterr().err
    arguments = ["--data", "nowhere.h5", "--out", str(tmp_path / "out")]
    assert train_graphene.main(arguments) == 2
    assert "out: another job is writing here" in capsys.readouterr().err
    with pytest.raises(InputError, match=r"state\.npz: another job"):
        fit(
            problem(),
            horizon=2.0,
            kernel=Bernstein(0),
            method=TwoStage(checkpoint=tmp_path / "state.npz", epochs=5),
        )


def test_a_killed_holder_holds_nothing(holder, tmp_path):
    process = holder(tmp_path / "out")
    process.kill()
    process.communicate()
    with locked(tmp_path / "out"):
        pass


def test_the_lock_ends_with_an_error_and_leaves_no_file(tmp_path):
    def fails():
        with locked(tmp_path / "out"):
            raise KeyError("x")

    with pytest.raises(KeyError):
        fails()
    with locked(tmp_path / "out"), refused(), locked(tmp_path / "out"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_one_output_by_two_names_is_one(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "out")
    with locked(tmp_path / "out"), refused(), locked(tmp_path / "link"):
        pass


SAVES = """
import sys
from warp_peri.files.atomic import whole_file
with whole_file(sys.argv[1]) as part:
    part.write_text("half")
    print(part, flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def saver():
    """Starts processes amid the save of a file; each with its half-written file."""
    started = []

    def save(target):
        process = subprocess.Popen(
            [sys.executable, "-c", SAVES, str(target)],
            cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        started.append(process)
        return process, Path(process.stdout.readline().strip())

    yield save
    for process in started:
        process.kill()
        process.communicate()


NAMES = ["m.json", "a[b]*.h5", "run[1]", "x?", "[!a]*", f"a{PART}1"]
"""With every character that a pattern has."""


@pytest.mark.parametrize("name", NAMES)
def test_the_next_save_clears_what_killed_ones_left_and_harms_none_that_lives(
    saver, tmp_path, name
):
    target = tmp_path / name
    saves = [saver(target) for _ in range(3)]
    saves[1][0].kill()
    saves[1][0].communicate()
    other = tmp_path / f".{name}x{PART}abc"
    other.write_text("of another file")
    parts = [part for _, part in saves]
    assert all(part.exists() and part.name.startswith(f".{name}{PART}") for part in parts)
    write_text(target, "mine")
    assert [part.exists() for part in parts] == [True, False, True]
    for process, _ in (saves[0], saves[2]):
        process.communicate("\n")
        assert process.returncode == 0
        assert target.read_text() == "half"
    assert sorted(tmp_path.iterdir()) == sorted([other, target])


@pytest.mark.parametrize("name", NAMES)
def test_a_job_clears_what_killed_ones_left_and_harms_none_that_lives(saver, tmp_path, name):
    out = tmp_path / name
    out.mkdir()
    lives, dead = [], []
    for target in (tmp_path / "run1", tmp_path / "xy", out / "m.json", out / name):
        lives.append(saver(target))
        dead.append(saver(target))
        dead[-1][0].kill()
        dead[-1][0].communicate()
    with locked(out), locked(out / "m.json"):
        assert [part.exists() for _, part in dead] == [True, True, False, False]
        for process, part in lives:
            assert part.exists()
            process.communicate("\n")
            assert process.returncode == 0
    assert (tmp_path / "run1").read_text() == (out / name).read_text() == "half"


@pytest.mark.parametrize("name", NAMES)
def test_hidden_files_of_a_user_stay(tmp_path, name):
    out = tmp_path / name
    out.mkdir()
    with whole_file(out / "m.json") as part:
        twin = part.name  # the name of a half-written file, on another file
    mine = [out / f".my{PART}1.txt", out / f".m.json{PART}abcdefgh.json", out / twin]
    mine += [tmp_path / f".{name}{PART}abcdefgh", tmp_path / f".{name}{PART}12{Path(name).suffix}"]
    mine += [out / f"{PART}1", out / f"seen{PART}1", out / ".hidden"]
    for path in mine:
        path.write_text("mine")
    with locked(out):
        write_text(out / "my", "x")
        write_text(out / "m.json", "x")
    write_text(out.with_name(name + "y"), "x")
    assert {path.read_text() for path in mine} == {"mine"}


def test_a_users_file_of_the_name_of_a_lock_stays(tmp_path):
    beside = tmp_path / ".out.lock"
    beside.write_text("mine")
    refusal = pytest.raises(InputError, match=r"\.out\.lock: expected no file, or an empty one")
    with refusal, locked(tmp_path / "out"):
        pass
    assert beside.read_text() == "mine"
