"""Frames of digital image correlation: headers, missing points, lattices, noise."""

import re

import numpy as np
import pytest

from warp_peri import InputError
from warp_peri.sources.dic import frames_of_folder, frames_on_lattice, noise_of, read_frame

X = np.argwhere(np.ones((15, 16), bool)) * 20.0 + [100.0, 60.0]


def field(x):
    return np.stack([0.1 * x[:, 0] + 1e-4 * x[:, 1] ** 2, -0.05 * x[:, 1] + 2.0], axis=1)


def rows(x, u, separator, extra=()):
    return "\n".join(
        separator.join(f"{value:.9g}" for value in (*place, *move, *extra))
        for place, move in zip(x, u)
    )


def plain(x, u):
    return "x,y,u,v\n" + rows(x, u, ",")


def semicolons(x, u):
    head = "x [pixel];y [pixel];x-displacement [pixel];y-displacement [pixel];Displacement [pixel]"
    return head + "\n" + rows(x, u, ";", (1.0,))


def dice(x, u):
    head = "*** Digital Image Correlation Engine (DICe)\n***\n"
    head += "SUBSET_ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,SIGMA,STATUS_FLAG\n"
    lines = [
        ",".join(f"{v:.9g}" for v in (n, *place, *move, 0.01, 4))
        for n, (place, move) in enumerate(zip(x, u))
    ]
    return head + "\n".join(lines)


def nodemap(x, u):
    head = "# ARAMIS export\n# force : 3.1\n# ID; x; y; z; ux; uy; uz; exx; eyy; exy\n"
    lines = [
        "; ".join(f"{v:.9g}" for v in (n, *place, 0, *move, 0, 0.1, 0.2, 0.3))
        for n, (place, move) in enumerate(zip(x, u))
    ]
    return head + "\n".join(lines)


@pytest.mark.parametrize("table", [plain, semicolons, dice, nodemap])
def test_headers_are_recognised(tmp_path, table):
    (tmp_path / "frame.txt").write_text(table(X, field(X)))
    frame = read_frame(tmp_path / "frame.txt", pixel=0.5)
    np.testing.assert_allclose(frame.x, 0.5 * X)
    np.testing.assert_allclose(frame.u, 0.5 * field(X), rtol=1e-8)
    assert frame.name == "frame.txt"


def test_points_without_a_number_are_left_out(tmp_path):
    text = dice(X, field(X)).splitlines()
    text[5] = "2,100,100,,1.0,0.01,4"
    text[6] = "3,100,120,1.0,1.0,-1,4"
    (tmp_path / "frame.txt").write_text("\n".join(text))
    assert len(read_frame(tmp_path / "frame.txt").x) == len(X) - 2


def test_points_on_a_lattice_stay_as_they_are(tmp_path):
    (tmp_path / "frame.csv").write_text(plain(X, field(X)))
    samples = frames_on_lattice([read_frame(tmp_path / "frame.csv")])
    assert samples.spacing == 20.0
    assert samples.b is None
    np.testing.assert_allclose(samples.u[0], field(samples.x), rtol=1e-7)
    assert samples.interior.sum() == 3 * 4


def test_a_missing_point_takes_its_surroundings_from_the_interior(tmp_path):
    big = np.argwhere(np.ones((25, 25), bool)) * 20.0
    (tmp_path / "a.csv").write_text(plain(big, field(big)))
    kept = (big != [240.0, 240.0]).any(axis=1)
    (tmp_path / "b.csv").write_text(plain(big[kept], field(big[kept])))
    frames = [read_frame(tmp_path / name) for name in ("a.csv", "b.csv")]
    samples = frames_on_lattice(frames)
    assert len(samples) == 2
    assert len(samples.x) == 25**2 - 1
    near = np.linalg.norm(samples.x - 240.0, axis=1) <= 2.5 * 20
    assert not samples.interior[near].any()
    assert samples.interior.any()


def test_scattered_points_are_fitted_locally(tmp_path):
    shaken = X + 4 * np.random.default_rng(0).uniform(-1, 1, X.shape)
    shaken[0] = X[0]
    (tmp_path / "frame.csv").write_text(plain(shaken, field(shaken)))
    samples = frames_on_lattice([read_frame(tmp_path / "frame.csv")], spacing=20.0, radius=2.0)
    np.testing.assert_allclose(samples.u[0], field(samples.x), atol=1e-6)  # quadratic: exact


def test_the_noise_is_estimated(tmp_path):
    big = np.argwhere(np.ones((30, 30), bool)) * 20.0
    random = np.random.default_rng(1)
    (tmp_path / "frame.csv").write_text(plain(big, field(big) + random.normal(0, 0.3, big.shape)))
    samples = frames_on_lattice([read_frame(tmp_path / "frame.csv")])
    assert noise_of(samples)[0] == pytest.approx(0.3, rel=0.15)


def test_a_polygon_masks(tmp_path):
    (tmp_path / "frame.csv").write_text(plain(X, field(X)))
    corners = [[0, 0], [1000, 0], [1000, 350], [0, 350]]
    samples = frames_on_lattice([read_frame(tmp_path / "frame.csv")], mask=np.array(corners))
    assert samples.x[:, 1].max() <= 350


@pytest.mark.parametrize(
    ("pixel", "header", "units", "spacing"),
    [
        ("0.5mm", "x,y", ("mm", "MPa"), 10.0),
        ("µm", "x,y", ("um", "MPa"), 20.0),
        (1.0, "x [mm],y [mm]", ("mm", "MPa"), 20.0),
        (1.0, "x,y", ("angstrom", "TPa"), 20.0),
    ],
)
def test_what_is_made_of_frames_has_the_unit_that_was_said(tmp_path, pixel, header, units, spacing):
    text = plain(X, field(X))
    (tmp_path / "frame.csv").write_text(text.replace(text[: text.index(",u")], header, 1))
    frame = read_frame(tmp_path / "frame.csv", pixel=pixel)
    samples = frames_on_lattice([frame])
    assert samples.points.units == units
    assert samples.spacing == pytest.approx(spacing)
    if units[0] == "mm":
        assert frames_on_lattice([frame], units=("mm", "Pa")).points.units == ("mm", "Pa")
        with pytest.raises(InputError, match="frames are in mm"):
            frames_on_lattice([frame], units="si")


@pytest.mark.parametrize("pixel", ["0.5 inch", "-1mm", "mm mm"])
def test_pixels_without_sense_are_refused(tmp_path, pixel):
    with pytest.raises(InputError, match="pixel: expected a length > 0, with a unit of angstrom"):
        read_frame(tmp_path / "frame.csv", pixel=pixel)


def test_what_is_no_frame_is_refused(tmp_path):
    (tmp_path / "bad.csv").write_text("time,load\n0,1\n")
    with pytest.raises(InputError, match="expected columns x, y, u and v"):
        read_frame(tmp_path / "bad.csv")
    with pytest.raises(InputError, match="pixel: expected a length > 0"):
        read_frame(tmp_path / "frame.csv", pixel=0.0)
    with pytest.raises(InputError, match="cannot be read"):
        read_frame(tmp_path / "missing.csv")
    (tmp_path / "small.csv").write_text(plain(X[:40], field(X[:40])))
    with pytest.raises(InputError, match="nodes a side"):
        frames_on_lattice([read_frame(tmp_path / "small.csv")])


def folder_of(path, frames):
    """Tables of a lattice of 15 x 16 points, so many of each."""
    path.mkdir()
    for number, count in enumerate(frames):
        (path / f"frame{number}.csv").write_text(plain(X[:count], field(X[:count])))
    return path


def test_frames_go_by_number_and_hidden_files_are_none(tmp_path):
    for name in [*(f"frame{n}.csv" for n in range(11)), ".frame3.csv"]:
        size = int(re.findall(r"\d+", name)[0])
        (tmp_path / name).write_text(plain(X, size * field(X)))
    taken = frames_of_folder(tmp_path, 11, radius=0.0)
    sizes = np.abs(taken.u).max(axis=(1, 2)) / np.abs(field(X)).max()
    np.testing.assert_allclose(sizes, np.arange(2.0, 11.0), rtol=1e-5)


def test_a_folder_tells_what_it_passes_over_and_what_does_not_fit(tmp_path):
    whole = folder_of(tmp_path / "whole", [len(X)] * 4)
    (whole / "force.csv").write_text("time,load\n0,1\n")
    with pytest.warns(UserWarning, match=r"passed over: .*force.csv: expected columns x, y"):
        assert len(frames_of_folder(whole, 7, radius=0.0)) == 4
    (whole / "frame1.csv").unlink()
    with pytest.raises(InputError, match="4 frames, got 3; .*force.csv: expected columns"):
        frames_of_folder(whole, 7, radius=0.0)
    unequal = folder_of(tmp_path / "unequal", [len(X)] * 3 + [100])
    with pytest.raises(InputError, match="frame3.csv has 100 nodes of 240, frame0.csv has 240"):
        frames_of_folder(unequal, 7, radius=0.0)
    for wrong, words in (
        ({"pixel": "2 inch"}, "pixel: expected a length"),
        ({"count": 3}, "count: expected at least 4 frames, got 3"),
        ({"radius": -1.0}, "radius: expected spacings"),
    ):
        with pytest.raises(InputError, match=words):
            frames_of_folder(unequal, **{"count": 7, "radius": 0.0} | wrong)


def test_frames_in_several_units_are_named(tmp_path):
    (tmp_path / "a.csv").write_text(plain(X, field(X)))
    frames = [read_frame(tmp_path / "a.csv", pixel=pixel) for pixel in ("mm", 1.0)]
    with pytest.raises(InputError, match="one unit of length, got mm in a.csv, no unit in a.csv"):
        frames_on_lattice(frames)
