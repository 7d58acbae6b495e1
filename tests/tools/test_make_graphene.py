"""Making the data set: cache, resume, errors, and what the file says."""

import numpy as np
import pytest

import tools.make_graphene as tool
from tools import samples
from tools.loads import PatchLoad, RimLoad, WaveLoad
from tools.samples import TRAINING_STRAIN, cache_file, read_sample
from tools.statics import TOLERANCE, ConvergenceError
from warp_peri.points.dataset import load_dataset


@pytest.fixture
def small(monkeypatch):
    """The tool on a small sheet, a small disk and five of the loads."""
    monkeypatch.setattr(tool, "SHEET_CELLS", (8, 5))
    monkeypatch.setattr(tool, "DISK_RADIUS", 65.0)
    monkeypatch.setattr(tool, "REACH", 60.0)
    monkeypatch.setattr(tool, "TRAINING", [WaveLoad(0, (0, 1)), WaveLoad(1, (2, 1))])
    monkeypatch.setattr(tool, "VALIDATION", [PatchLoad(1, 0, 0, 8.0), PatchLoad(2, 1, 1, 5.0)])
    monkeypatch.setattr(tool, "TEST", [RimLoad(3)])


def make(folder, name="g.h5", **options):
    return tool.make_graphene(
        folder / name, jobs=1, cache=folder / "cache", progress=False, **options
    )


def forbid_solving(monkeypatch):
    def refuse(body, loads, cache):
        raise AssertionError(f"solved again: {[load.load_id for load in loads]}")

    monkeypatch.setattr(tool, "solve_samples", refuse)


def test_data_set_cache_and_resume(small, tmp_path, monkeypatch):
    data = load_dataset(make(tmp_path))
    assert sorted(data) == ["test", "test_fine", "train", "train_fine", "val", "val_fine"]
    train = data["train"]
    assert train.spacing == 5.0
    assert data["train_fine"].spacing == 2.5
    assert list(train.arrays["load_id"]) == ["x k=(0,1)", "y k=(2,1)"]
    assert list(data["test"].arrays["load_id"]) == ["table2-3"]
    for points in data.sets.values():
        assert (points.arrays["residual"] <= TOLERANCE).all()
        assert (points.arrays["amplitude"] > 0).all()
    strain = train.arrays["max_bond_strain"]
    assert np.abs(strain / TRAINING_STRAIN - 1).max() <= 1e-4
    assert data.density == pytest.approx(2147, rel=2e-3)
    truth = data.provenance["truth"]
    assert truth["mu"] == pytest.approx(0.7223, abs=1e-4)
    assert 0 < data.provenance["u_change_cone_to_paraboloid"]["longest_wave"] < 0.2

    # The finished cache alone gives the same file, and one corrupt sample is made again.
    with monkeypatch.context() as patch:
        forbid_solving(patch)
        again = load_dataset(make(tmp_path, "again.h5"))
        assert all(np.array_equal(again[name].u, data[name].u) for name in data)
    broken = next(iter((tmp_path / "cache").glob("table1-2-*.npz")))
    content = bytearray(broken.read_bytes())
    content[len(content) // 2] ^= 0xFF
    broken.write_bytes(content)
    solved = []
    with monkeypatch.context() as patch:
        patch.setattr(
            tool,
            "solve_samples",
            lambda body, loads, cache: (
                solved.extend(loads) or samples.solve_samples(body, loads, cache)
            ),
        )
        with pytest.warns(UserWarning, match="table1-2.*corrupt"):
            repaired = load_dataset(make(tmp_path, "repaired.h5"))
    assert solved == [PatchLoad(2, 1, 1, 5.0)]
    assert np.allclose(repaired["val"].u, data["val"].u, atol=1e-10)


def test_smoothed_load_keeps_its_axis_and_does_positive_work(small, tmp_path):
    data = load_dataset(make(tmp_path))
    train = data["train_fine"]
    assert np.abs(train.b[0, :, 1]).max() == 0
    work = (train.u * train.b).sum(axis=(1, 2))
    assert (work > 0).all()


def test_failed_run_leaves_no_file_but_keeps_what_is_done(small, tmp_path, monkeypatch, capsys):
    def fail(body, statics, load, real=samples.solve):
        if load.load_id == "table1-2":
            raise ConvergenceError(f"load '{load.load_id}': residual 1 eV/Å")
        return real(body, statics, load)

    monkeypatch.setattr(samples, "solve", fail)
    arguments = ["--out", str(tmp_path / "g.h5"), "--jobs", "1", "--quiet"]
    assert tool.main(arguments) == 1
    message = capsys.readouterr().err
    assert message.strip() == "make_graphene: error: load 'table1-2': residual 1 eV/Å"
    assert not (tmp_path / "g.h5").exists()
    left = sorted(path.name for path in (tmp_path / "g.cache").iterdir())
    assert len(left) == 4
    assert not any(name.startswith(".") for name in left)


def test_full_disk(small, tmp_path, monkeypatch, capsys):
    def full(path, **_):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(samples.np, "savez", full)
    assert tool.main(["--out", str(tmp_path / "g.h5"), "--jobs", "1", "--quiet"]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert list((tmp_path / "g.cache").iterdir()) == []


def test_interrupt(small, tmp_path, monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(tool, "solve_samples", interrupt)
    assert tool.main(["--out", str(tmp_path / "g.h5"), "--jobs", "1", "--quiet"]) == 130
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not (tmp_path / "g.h5").exists()


def test_missing_potential(small, tmp_path, monkeypatch, capsys):
    def missing(*_):
        raise FileNotFoundError("interatomic potential not found: X.tersoff")

    monkeypatch.setattr(tool, "potential_file", missing)
    assert tool.main(["--out", str(tmp_path / "g.h5"), "--quiet"]) == 1
    assert "X.tersoff" in capsys.readouterr().err


def test_jobs_must_make_sense(tmp_path, capsys):
    with pytest.raises(ValueError, match="jobs"):
        tool.make_graphene(tmp_path / "g.h5", jobs=0)
    with pytest.raises(SystemExit) as stop:
        tool.main(["--jobs", "-3"])
    assert stop.value.code == 2
    assert "--jobs" in capsys.readouterr().err


def test_cache_key_knows_what_decides(tmp_path):
    potential = tmp_path / "C.tersoff"
    potential.write_text("one")
    body = samples.Piece(1.46, str(potential), cells=(8, 5))
    load = WaveLoad(0, (1, 0))
    keys = {cache_file(tmp_path, body, load).name}
    keys.add(cache_file(tmp_path, body, WaveLoad(0, (0, 1))).name)
    keys.add(cache_file(tmp_path, samples.Piece(1.46, str(potential), cells=(8, 6)), load).name)
    potential.write_text("two")
    keys.add(cache_file(tmp_path, body, load).name)
    assert len(keys) == 4
    assert read_sample(cache_file(tmp_path, body, load)) is None
