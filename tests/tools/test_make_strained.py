"""Data at larger strain: continuation, cache, and the constants in the file."""

import numpy as np
import pytest

import tools.make_graphene as base
import tools.make_strained as tool
from tools.loads import PatchLoad, RimLoad
from warp_peri import InputError
from warp_peri.points.dataset import load_dataset


@pytest.fixture
def small(monkeypatch):
    """The tool on a small sheet, a small disk and two of the loads."""
    monkeypatch.setattr(base, "SHEET_CELLS", (8, 5))
    monkeypatch.setattr(base, "DISK_RADIUS", 65.0)
    monkeypatch.setattr(base, "REACH", 60.0)
    monkeypatch.setattr(base, "VALIDATION", [PatchLoad(1, 0, 0, 8.0)])
    monkeypatch.setattr(base, "TEST", [RimLoad(3)])


@pytest.mark.slow
def test_loads_are_scaled_to_the_strains_asked_for(small, tmp_path, monkeypatch):
    options = {"strains": (0.03, 0.05), "jobs": 1, "progress": False}
    data = load_dataset(tool.make_strained(tmp_path / "s.h5", **options))
    assert sorted(data) == ["test_3", "test_5", "val_3", "val_5"]
    for name, points in data.sets.items():
        strain = int(name.split("_")[1]) / 100
        assert np.abs(points.arrays["max_bond_strain"] / strain - 1).max() <= 1e-3
        assert (points.arrays["residual"] <= base.TOLERANCE).all()
    amplitudes = [data[name].arrays["amplitude"] for name in ("val_3", "val_5")]
    assert (amplitudes[0] < amplitudes[1]).all()
    # the finished cache alone gives the same file
    with monkeypatch.context() as patch:
        patch.setattr(tool, "strained", None)
        again = load_dataset(
            tool.make_strained(tmp_path / "again.h5", cache=tmp_path / "s.cache", **options)
        )
    assert all(np.array_equal(again[name].u, data[name].u) for name in data)
    truth = data.provenance["truth"]
    assert [truth[key] for key in ("t3", "tq2", "q3")] == pytest.approx(
        [-0.500, -6.84, 1.045], rel=2e-3
    )
    assert [truth[key] for key in ("C111", "C222", "C112")] == pytest.approx(
        [-12.5, -14.0, -0.36], rel=2e-2
    )


def test_strains_that_do_not_grow_are_refused(tmp_path, capsys):
    for strains in ((0.05, 0.03), (), (-0.01, 0.02)):
        with pytest.raises(InputError, match="strains: expected numbers > 0 that grow"):
            tool.make_strained(tmp_path / "s.h5", strains=strains)
    assert tool.main(["--out", str(tmp_path / "s.h5"), "--strains", "0.05", "0.03"]) == 2
    assert "expected numbers > 0 that grow" in capsys.readouterr().err
