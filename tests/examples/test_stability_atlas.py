"""The stability atlas: quick entries run; the page has a figure and an error for each."""

import json
import re
import shutil
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

from examples.studies import (
    atlas_bodies,
    atlas_cracks,
    atlas_kernels,
    atlas_solves,
    stability_atlas,
)
from examples.studies.atlas_entry import filled, words
from tests.micromodulus.crystals import learned
from tests.support.problems import kernel
from warp_peri.errors import InputError

DOCS = Path(__file__).parent.parent.parent / "docs"
NAMES = (
    "sign-changing", "spacing", "exponent", "horizon", "degree", "lame", "scattered", "transfer",
    "surfaces", "bodies", "crystals", "supercell", "time-step", "energy", "dispersion", "strain",
    "larger-strains", "float32", "ranks", "compression", "edges",
    "uneven", "noisy-strains", "predictions", "noise-of-its-own", "stretched-and-turned", "broken",
    "cracks-in-space", "stretch", "edge-tips", "long-steps",
)  # fmt: skip


KEPT = json.loads((DOCS / "stability" / "stability.json").read_text(encoding="utf-8"))


def test_the_study_has_every_entry_with_figure_number_and_what_is_seen():
    page = (DOCS / "archive" / "stability.md").read_text(encoding="utf-8")
    sections = page.split("\n## ")[1:]
    assert len(sections) == len(NAMES)
    for name, section in zip(NAMES, sections):
        assert f"](../stability/{name}.png)" in section
        assert (DOCS / "stability" / f"{name}.png").stat().st_size > 10_000
        number = re.search(r"\*\*(.*?)\*\*", section)[1]
        assert re.search(r"\d", number)
        seen = section.split("What a user sees:")[1]
        assert re.search(r"^    (InputError|UserWarning|certificate): ", seen, re.M)


def test_both_pages_are_made_of_what_was_measured(tmp_path):
    (tmp_path / "stability").mkdir()
    shutil.copy(DOCS / "stability" / "stability.json", tmp_path / "stability")
    assert stability_atlas.main(["--again", "--out", str(tmp_path)]) == 0
    for place in stability_atlas.PAGES.values():
        assert (tmp_path / place).read_text("utf-8") == (DOCS / place).read_text("utf-8")


def test_readers_have_every_entry_once_and_its_message_in_the_table():
    shown = [name for names in stability_atlas.PARTS.values() for name in names]
    assert sorted(shown) == sorted(NAMES)
    assert tuple(KEPT) == NAMES
    for name in NAMES:
        entry = filled(name, KEPT[name]["numbers"])
        assert len(entry.brief.split()) <= 60, name
        symptom, cause, remedy = entry.row.split(" | ")
        assert cause
        assert remedy
        for quoted in re.findall(r"`([^`]*)`", symptom):
            if "=" not in quoted or "edges" in quoted:
                parts = map(re.escape, quoted.split(" … "))
                assert re.search(".*".join(parts), "\n".join(KEPT[name]["seen"])), quoted


@pytest.mark.slow
def test_steep_kernels_lose_shear_and_keep_their_symbol():
    entry = atlas_kernels.steep_kernels()
    shear = {a: atlas_kernels.plain_symbol(a, 3.0) for a in (1.0, 2.999, 10.0)}
    assert shear[1.0][0] == pytest.approx(1.0)
    assert shear[2.999][0] < 0.85
    assert shear[10.0][0] < 0.1
    assert shear[2.999][1] > 0.3
    assert entry.seen == ["InputError: alpha: expected less than 3, got 3.0"]
    plt.close(entry.figure)


def test_float32_loses_forces_under_a_rigid_shift():
    entry = atlas_solves.single_precision()
    error = entry.values["error"]
    assert error["float32"][0] > 1e-8
    assert error["float32"][-1] > 0.9
    assert error["float64"][-1] < 1e-2
    assert "u: expected float32" in entry.seen[0]
    plt.close(entry.figure)


@pytest.mark.parametrize("ratio", [-0.27, 3.0])
def test_the_corrected_edge_is_better(ratio):
    lam = ratio * atlas_solves.MU
    corrected, plain = (atlas_solves.free_edge(16, lam, corrected=kind) for kind in (True, False))
    assert corrected < 0.7 * plain


def test_an_unprovoked_failure_is_not_taken_for_one():
    with pytest.raises(RuntimeError, match="expected an error or a warning"):
        words(lambda: None)


def test_an_unknown_entry_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(stability_atlas, "make_data", lambda *_: tmp_path)
    monkeypatch.setattr(stability_atlas.wp, "load", lambda _: {})
    with pytest.raises(InputError, match="--only: expected some of sign-changing"):
        stability_atlas.main(["--only", "nothing", "--out", str(tmp_path)])


def test_crystals_feel_their_turn_on_cut_faces_and_a_direction_that_is_not_stated():
    law = learned(3)
    traction = atlas_bodies.turned_face(law)
    assert traction == pytest.approx((0.122 - 0.076) / 2, rel=1e-8)
    assert traction == pytest.approx(law._surface_traction(), rel=1e-8)
    seen = atlas_bodies.refusals(learned(2))
    assert "not objective" in seen[0]
    assert "stands at 20°" in seen[1]


def test_a_broken_learned_kernel_is_indefinite_and_a_positive_one_is_not():
    entry = atlas_cracks.broken_kernels(kernel("sign-changing", 3.0), spacing=1.0, cells=20)
    assert max(entry.values["negative"]["K = 1/r"]) == 0
    assert entry.values["negative"]["learned"][0] == 0
    assert entry.values["negative"]["learned"][-1] > 0
    assert "changes sign" in entry.seen[0]
    plt.close(entry.figure)


@pytest.mark.slow
def test_kernels_that_change_sign_break_in_space_too():
    entry = atlas_cracks.in_space(cells=10)
    counts = entry.values["negative"]
    assert max(counts["K = 1/r"]) == counts["changes sign"][0] == 0 < counts["changes sign"][-1]
    assert "changes sign" in entry.seen[0]
    for cuts in entry.values["cuts"].values():
        assert cuts[-1] == pytest.approx(1.0, abs=0.02)
    plt.close(entry.figure)


def test_steps_beyond_the_bound_grow():
    entry = atlas_cracks.long_steps(60)
    assert entry.values["growth"]["1.1"] > 1e3 > 10 > entry.values["growth"]["0.98"]
    plt.close(entry.figure)


@pytest.mark.slow
def test_a_shifted_tip_is_nearer_at_three_spacings():
    entry = atlas_cracks.edge_tips((6, 13), (2.0, 3.0, 4.0))
    errors = entry.values["errors"]
    for ratio in ("3h", "4h"):
        both = zip(errors[f"{ratio}, as cut"], errors[f"{ratio}, shifted"])
        assert all(0 < shifted < 0.7 * plain for plain, shifted in both)
    assert "three lengths or more" in entry.seen[0]
    plt.close(entry.figure)


@pytest.mark.slow
def test_stretches_are_misjudged():
    entry = atlas_cracks.misjudged_stretch(cells=8, length=1)
    assert entry.values["ratios"]["1.0"] > 1.1
    assert "at rest" in entry.seen[0]
    plt.close(entry.figure)
