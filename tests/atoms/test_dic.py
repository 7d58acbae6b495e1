"""Frames of digital image correlation: headers, missing points, lattices, noise."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import inv, lstsq, norm
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal

from tests.support import approx, assert_refused, each_refused, parametrize, refused, sup, warned
from tests.support.problems import normal
from warp_peri.atoms.dic import dic_to_lattice, estimate_noise, frames_of_folder, read_dic_frame
from warp_peri.points.points import SEEN, grid_places

X = grid_places((15, 16)) * 20.0 + [100.0, 60.0]
field = lambda x: np.stack([0.1 * x[:, 0] + 1e-4 * x[:, 1] ** 2, -0.05 * x[:, 1] + 2.0], axis=1)
BIG = grid_places((30, 25)) * 2.5 + 0.125
GRADIENT = np.array([[0.013, -0.002], [0.004, -0.007]])
LINEAR = *BIG.T, *(BIG @ GRADIENT.T).T


def write(path, columns, header="x,y,u,v", encoding="utf-8"):
    """A table of columns, or of x and u, as a file."""
    rows = np.hstack(columns) if np.ndim(columns[0]) == 2 else zip(*columns)
    table = "\n".join(",".join(str(value) for value in row) for row in rows)
    path.write_bytes((header + "\n" + table).encode(encoding))
    return path


@pytest.fixture
def frame_of(tmp_path):
    """Makes a frame of a table with x and u."""
    return lambda x, u: read_dic_frame(write(tmp_path / "a.csv", (x, u)))


def test_points_on_a_lattice_stay_and_scattered_ones_are_fitted_locally(frame_of):
    samples = dic_to_lattice([frame_of(X, field(X))])
    assert (samples.spacing, samples.b, samples.interior.sum()) == (20.0, None, 3 * 4)
    assert_allclose(samples.u[0], field(samples.x), rtol=1e-7)
    shaken = X + 4 * default_rng(0).uniform(-1, 1, X.shape)
    shaken[0] = X[0]
    samples = dic_to_lattice([frame_of(shaken, field(shaken))], spacing=20.0, radius=2.0)
    assert_allclose(samples.u[0], field(samples.x), atol=1e-6)  # quadratic: exact
    noisy = dic_to_lattice([frame_of(BIG, field(BIG) + 0.3 * normal(BIG.shape, 1))])
    assert estimate_noise(noisy)[0] == approx(0.3, rel=0.15)
    turned = replace(noisy.points, x=noisy.x @ [[0.8, 0.6], [-0.6, 0.8]])
    assert estimate_noise(replace(noisy, points=turned)) == approx(estimate_noise(noisy))


@parametrize("radius", [0.0, 1.5])
def test_points_lost_in_single_frames_are_missing_there_alone(frame_of, radius):
    """What all frames lost is a hole, and nodes near it are not of the interior."""
    from_hole = norm(BIG - BIG[12 * 25 + 4], axis=1)
    hole = from_hole < 6
    rng = default_rng(5)
    losses = [rng.uniform(size=len(BIG)) < 0.03 for _ in range(7)]
    frames = []
    for part, lost in enumerate(losses, 1):
        u = part * BIG @ GRADIENT.T + 1e-3 * part * (BIG - 20) ** 2
        frames.append(frame_of(BIG[~lost & ~hole], u[~lost & ~hole]))
    marked = replace(frames[-1], x=BIG, u=np.where((lost | hole)[:, None], np.nan, u))
    assert_array_equal(marked.x, frames[-1].x)
    samples = dic_to_lattice(frames, spacing=2.5, radius=radius)
    assert_array_equal(samples.x, BIG[~hole])
    unseen = ~samples.arrays[SEEN] if radius == 0 else np.array(losses)[:, ~hole]
    assert_array_equal(unseen, np.array(losses)[:, ~hole])
    assert samples.interior.sum() > 10 * 13
    assert not samples.interior[from_hole[~hole] < 15].any()
    for part, u in enumerate(samples.u, 1):
        true = part * samples.x @ GRADIENT.T + 1e-3 * part * (samples.x - 20) ** 2
        assert_allclose(u, true, atol=1e-6)


def gradient(samples):
    """That of a displacement that is linear, [displacement, position]."""
    return lstsq(np.c_[np.ones(len(samples.x)), samples.x], samples.u[0], rcond=None)[0][1:].T


def told(path, header, columns, *, encoding="utf-8", **options):
    """The samples that a table tells; `columns` are numbers of x, y, u, v and text."""
    return dic_to_lattice([read_dic_frame(write(path, columns, header, encoding), **options)])


def test_columns_and_their_units_are_what_a_header_says_behind_a_comment_too(tmp_path):
    """x in mm beside u in µm: a strain of one hundredth is not ten."""
    meant = dict(zip("xyuv", LINEAR))
    meant |= {str(n + 1): 1.1 * meant[name] + 3 for n, name in enumerate("xyuv")}
    meant["."] = np.arange(len(BIG)) % 7 + 1.0
    # header, what its columns hold (strains ., pixels 1234 of x, y, u, v), sizes, unit
    for header, holds, sizes, unit, how in (
        ("id,x,y,u,v,sigma,eyy", ".xyuv..", 4 * [1], "angstrom", {}),
        ("#X,Y,Z,U,V,W,x,y,u,v", "xy.uv.1234", 4 * [1], "angstrom", {}),
        ("#  ID,x_undef [mm],y_undef [mm],z_undef [mm],u [mm],v [mm],w [mm],ex [%]", ".xy.uv..",
         4 * [1], "mm", {}),
        ("ID,COORDINATE_X,COORDINATE_Y,DISPLACEMENT_X,DISPLACEMENT_Y,MODEL_COORDINATES_X,"
         "MODEL_COORDINATES_Y,MODEL_DISPLACEMENT_X,MODEL_DISPLACEMENT_Y,SIGMA", ".1234xyuv.",
         4 * [1], "angstrom", {}),
        ("coor.X [mm],coor.Y [mm],disp.Horizontal Displacement U [mm],"
         "disp.Vertical Displacement V [mm]", "xyuv", 4 * [1], "mm", {}),
        ("#v,y,u,x,x_def", "vyux.", 4 * [1], "angstrom", {}),
        ("x_mm,y_mm,u_um,v_um", "xyuv", (1, 1, 1e-3, 1e-3), "mm", {}),
        ("x [mm],y,u [um],v", "xyuv", (1, 1, 1e-3, 1e-3), "mm", {}),
        ("x,y,u,v\ninch,inch,um,um", "xyuv", (25.4, 25.4, 1e-3, 1e-3), "mm", {}),
        ("x,y,u,v", "xyuv", 4 * [3], "um", {"pixel": "3um"}),
        ("x [px],y [px],u [mm],v [mm]", "xyuv", (0.5, 0.5, 1, 1), "mm", {"pixel": "0.5mm"}),
        ("x [\N{MICRO SIGN}m],y,u,v", "xyuv", 4 * [1], "um", {"encoding": "utf-16"}),
    ):  # fmt: skip
        size = dict(zip("xyuv", sizes))
        columns = [np.round(meant[one] / size.get(one, 1), 9) for one in holds]
        samples = told(tmp_path / "a.csv", header, columns, **how)
        assert samples.points.units[0] == unit
        assert samples.spacing == approx(2.5)
        assert_allclose(gradient(samples), GRADIENT, atol=1e-6, err_msg=header)


def test_columns_that_contradict_each_other_are_refused(tmp_path, frame_of):
    columns = dict(zip("xyuv!_.", (*LINEAR, [1e300] * (n := len(BIG)), [0] * n, ["True"] * n)))

    def read(header, names, pixel=1.0):
        told(tmp_path / "a.csv", header, [columns[name] for name in names], pixel=pixel)

    each_refused(read, {
        "one column of a kind, got 'u' and 'ux'": ("x,y,u,ux,v", "xyuuv"),
        "expected units of angstrom, .* got 'furlong'": ("x [mm],y [mm],u [furlong],v", "xyuv"),
        "the size of a pixel with one, got x in no unit": ("x,y,u [mm],v [mm]", "xyuv"),
        "expected 4 fields, as in its header, got": ("x,y,u,v", "xyuvv"),
        "expected a number, got 'True'": ("x,y,u,v", "xyu."),
        "a.csv: x, y, u, v: expected finite values, got 1e.300": ("x,y,u,v", "xyu!"),
        "a.csv: .* expected each point once": ("x,y,u,v", "__uv"),
        "pixel: expected a length > 0, with a unit of ang": ("x,y,u,v", "xyuv", "0.5 inch"),
        "or none, got ''": ("x,y,u,v", "xyuv", ""),
    })  # fmt: skip
    assert_refused({
        "one displacement for each point":
            lambda: frame_of(np.ones((9, 2)), np.arange(18.0).reshape(9, 2)),
        r"missing.csv: no such file": lambda: read_dic_frame(tmp_path / "missing.csv"),
        "nodes a side": tuple(
            lambda spacing=h, x=x: dic_to_lattice([frame_of(x, field(x))], spacing=spacing)
            for x, h in ((X[:40], None), (X, 1e-8), (X, 1e-300))
        ),
    })  # fmt: skip
    path = write(tmp_path / "b.csv", (X, field(X)))
    with refused(r"one unit of length, got mm in b.csv, no unit in b.csv"):
        dic_to_lattice([read_dic_frame(path, pixel=pixel) for pixel in ("mm", 1.0)])


@parametrize("column", ["MATCH", "converged", "none", "other", "u alone"])
def test_lost_points_are_left_out_whatever_marks_them(tmp_path, column):
    """By a column, or by 0 or another number that fills in both components, or one of them."""
    rng = default_rng(3)
    x, y, u, v = LINEAR
    u, v = (values + 1e-3 * rng.standard_normal(len(x)) for values in (u, v))
    lost = rng.uniform(size=len(x)) < 0.1
    lost[:3] = [False, True, True]
    if column == "u alone":  # where 0 could not be what is there
        lost &= np.abs(u) > 0.02
    fill = {"other": -999.0, "converged": u}.get(column, 0.0)
    mark = {"MATCH": (0, -1), "converged": ("True", "False")}
    columns = [x, y, np.where(lost, fill, u)]
    columns.append(v if column == "u alone" else np.where(lost, fill, v))
    if column in mark:
        columns.append(np.where(lost, *mark[column][::-1]))
    header = ",".join([*"xyuv", column][: len(columns)])
    assert_array_equal(read_dic_frame(write(tmp_path / "a.csv", columns, header)).x, BIG[~lost])


def test_a_point_at_rest_is_kept(frame_of):
    """u is 0, 0 at the middle of what is stretched, on a held edge, and before the test."""
    centred = BIG - BIG[12 * 25 + 12]
    held = np.maximum(0, BIG[:, 0] - 10)  # beside what moves, a part that does not
    apart = np.stack([0.1 * BIG[:, 0], 1e-3 * held**2], axis=1)
    for field in (centred @ GRADIENT.T, centred**2 * 1e-3, 0 * centred, apart, apart.round(3)):
        assert len(frame_of(BIG, field).x) == len(BIG)


@parametrize(("strain", "noise"), [(0.2, 0.0), (0.003, 0.005)])
def test_positions_of_the_current_frame_are_taken_back(tmp_path, frame_of, strain, noise):
    """Of several frames by where their points are, of one by the lattice they were on."""
    rng = default_rng(1)
    frames = []
    for part in (1.0, 0.6, 0.3):
        u = part * BIG @ np.diag([strain, -0.3 * strain]) + noise * rng.standard_normal(BIG.shape)
        frames.append(frame_of(BIG + u, u))
    for some in (frames, frames[:1]):
        with warned("positions are those of the current frame"):
            found = gradient(dic_to_lattice(some, spacing=2.5))
        assert_allclose(found, np.diag([strain, -0.3 * strain]), atol=1e-6 + noise / 25)
    asked = dic_to_lattice(frames, spacing=2.5, positions="current")
    assert_allclose(gradient(asked), found, atol=1e-6 + noise / 25)
    path = write(tmp_path / "a.csv", [*(BIG + u).T, *u.T], "x_def,y_def,u,v")
    assert_allclose(read_dic_frame(path).x, BIG, atol=1e-6)


def test_positions_that_nothing_tells_are_asked_for(frame_of):
    rng = default_rng(0)
    sets = [BIG + rng.uniform(-0.8, 0.8, BIG.shape) for _ in range(2)]
    frames = [frame_of(x, x @ GRADIENT.T) for x in sets]
    with refused('positions="reference" or "current" says which'):
        dic_to_lattice(frames, spacing=2.5, radius=2.5)
    found = gradient(dic_to_lattice(frames, spacing=2.5, radius=2.5, positions="current"))
    assert_allclose(found, GRADIENT @ inv(np.eye(2) - GRADIENT), atol=1e-9)


def folder_of(path, frames):
    """Tables of so many points of a lattice of 15 x 16, moved by size times the field."""
    path.mkdir()
    for name, (count, size) in frames.items():
        write(path / name, (X[:count], size * field(X[:count])))
    return path


def test_frames_go_by_number_and_hidden_files_are_none(tmp_path):
    names = {f"frame{n}.csv": (len(X), n) for n in range(11)} | {".frame3.csv": (len(X), 3)}
    taken = frames_of_folder(folder_of(tmp_path / "many", names), 11, radius=0.0)
    assert_allclose(np.abs(taken.u).max((1, 2)) / sup(field(X)), np.arange(2.0, 11.0), rtol=1e-5)


def test_a_folder_tells_what_it_passes_over_and_what_does_not_fit(tmp_path):
    whole = folder_of(tmp_path / "whole", {f"frame{n}.csv": (len(X), 1) for n in range(4)})
    (whole / "force.csv").write_text("time,load\n0,1\n")
    with warned(r"passed over: .*force.csv: expected columns x, y"):
        assert len(frames_of_folder(whole, 10**14, radius=0.0)) == 4
    (whole / "frame1.csv").unlink()
    counts = {f"frame{n}.csv": (100 if n == 3 else len(X), 1) for n in range(4)}
    unequal, none = folder_of(tmp_path / "unequal", counts), folder_of(tmp_path / "none", {})
    for name in ("Ncorr.mat", "frame.npy"):
        (none / name).write_bytes(b"none")

    def read(folder, count=7, radius=0.0, stress=()):
        frames_of_folder(folder, count, radius=radius, stress=stress)

    each_refused(read, {
        "4 frames, got 3; .*force.csv: expected columns": whole,
        r"4 frames, got 0; of .mat, .npy files none; write x": none,
        "frame3.csv has 100 nodes of 240, frame0.csv has 240": unequal,
        "count: expected at least 4 frames, got 3": (unequal, 3),
        "radius: expected a number ≥ 0": (unequal, 7, -1.0),
        "stress: expected finite .* inf": (unequal, 7, 0.0, (0, np.inf, 1, 2)),
    })  # fmt: skip
