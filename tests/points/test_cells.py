"""What is no mesh of a body, in the plane and in space: refused, or mended with a word."""

import itertools
from contextlib import nullcontext

import meshio
import numpy as np
import pytest

import warp_peri as wp
from tests.support.problems import kernel
from warp_peri.errors import InputError
from warp_peri.points.mesh import REST, load_mesh, make_mesh, make_tetrahedra, pieces
from warp_peri.statics.solution import Coupling


def grid(*sides, size=1.0, origin=0.0):
    """Corners of squares or cubes, and these by their corners in turn."""
    steps = np.stack(np.meshgrid(*[np.arange(n + 1) for n in sides], indexing="ij"), -1)
    number = np.arange(steps[..., 0].size).reshape(steps.shape[:-1])
    turns = {2: ((0, 0), (1, 0), (1, 1), (0, 1))}.get(len(sides))
    turns = turns or [(*p, z) for z in (0, 1) for p in ((0, 0), (1, 0), (1, 1), (0, 1))]
    cells = [number[tuple(slice(o, o + n) for o, n in zip(p, sides))].ravel() for p in turns]
    return origin + size * steps.reshape(-1, len(sides)).astype(float), np.stack(cells, axis=1)


HALVES = [[0, 1, 2], [0, 2, 3]]
SIXTHS = []
for order in itertools.permutations(((1, 0, 0), (0, 1, 0), (0, 0, 1))):
    walk = np.cumsum([(0, 0, 0), *order], axis=0)
    turn = {(0, 0): 0, (1, 0): 1, (1, 1): 2, (0, 1): 3}
    SIXTHS.append([turn[x, y] + 4 * z for x, y, z in walk.tolist()])


def body(x, blocks):
    """The mesh of squares cut in two, or cubes in six."""
    d = x.shape[1]
    cells = np.concatenate([blocks[:, part] for part in (HALVES if d == 2 else SIXTHS)])
    return make_mesh(x, cells) if d == 2 else make_tetrahedra(x, cells)


def size(mesh):
    corners = mesh.x[mesh.cells]
    parts = {2: 2, 3: 6}[mesh.x.shape[1]]
    return np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])).sum() / parts


def joined(*grids):
    """Grids in one mesh, each with corners of its own."""
    first = np.cumsum([0, *(len(x) for x, _ in grids)])
    return np.concatenate([x for x, _ in grids]), np.concatenate(
        [cells + n for (_, cells), n in zip(grids, first)]
    )


@pytest.mark.parametrize("sides", [(4, 3), (3, 2, 2)])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_corners_at_one_place_are_one_and_a_word_says_so(sides, scale):
    x, blocks = grid(*sides, size=scale)
    whole = body(x, blocks)
    apart = x[blocks].reshape(-1, len(sides))
    parted = np.arange(len(apart)).reshape(blocks.shape)
    with pytest.warns(UserWarning, match=f"{len(apart) - len(x)} of {len(apart)} corners lie"):
        welded = body(apart, parted)
    assert len(welded.x) == len(x)
    assert len(welded.faces) == len(whole.faces)
    assert set(pieces(welded.cells)) == {0}
    beside = joined(grid(*sides, size=scale), grid(*sides, size=scale, origin=0.0))
    moved = beside[0] + (np.arange(len(beside[0])) >= len(x))[:, None] * np.eye(len(sides))[0] * (
        sides[0] * scale
    )
    with pytest.warns(UserWarning, match="lie where others do"):
        assert set(pieces(body(moved, beside[1]).cells)) == {0}


@pytest.mark.parametrize("sides", [(2, 2), (2, 2, 2)])
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(
    ("ratio", "shift", "words"),
    [
        (0.5, 2.0, "goes on beyond"),  # small beside large: hanging
        (1.0, 1.7, "goes on beyond"),  # one over the other
        (0.3, 0.4, "goes on beyond"),  # one within the other
        (1.0, 0.0, "expected one or two at each|lie on one side"),  # twice
    ],
)
def test_cells_that_overlap_or_share_parts_of_facets_are_refused(sides, scale, ratio, shift, words):
    large, small = grid(*sides, size=scale), grid(*sides, size=ratio * scale)
    if ratio == 0.5:
        small = grid(*(2 * n for n in sides), size=ratio * scale)
    small[0][:, 0] += shift * scale
    if 0 < shift < 2:
        small[0][:] += 0.13 * scale
    with (
        pytest.warns(UserWarning, match="lie where others do")
        if shift in (0.0, 2.0)
        else nullcontext(),
        pytest.raises(InputError, match=words),
    ):
        body(*joined(large, small))


def test_a_crack_with_a_width_is_an_outline_and_one_without_is_closed():
    x, blocks = grid(4, 4)
    crack = (x[:, 0] < 2) & (x[:, 1] == 2)
    number = np.where(crack, len(x) + np.cumsum(crack) - 1, np.arange(len(x)))
    above = x[blocks].mean(axis=1)[:, 1] > 2
    blocks[above] = number[blocks[above]]
    wide = np.concatenate([x, x[crack] + [0, 0.01]])
    assert len(body(wide, blocks).edges) == 16 + 4
    with pytest.warns(UserWarning, match="2 of 27 corners .* a crack needs a width"):
        assert len(body(np.concatenate([x, x[crack]]), blocks).edges) == 16


KITE = np.array([[0.0, 0, 0], [10, 4, 0], [20, 0, 0], [10, 20, 0]])
HOUSE = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [20, 5, 0]])


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("sense", [1, -1])
def test_quadrilaterals_are_cut_where_they_are_turned_in(tmp_path, turn, sense):
    quad = np.roll([0, 1, 2, 3], turn)[::sense]
    meshio.Mesh(KITE, [("quad", [quad])]).write(tmp_path / "kite.vtu")
    assert size(load_mesh(tmp_path / "kite.vtu")) == pytest.approx(160)
    meshio.Mesh(HOUSE, [("quad", [quad[[0, 2, 1, 3]]])]).write(tmp_path / "bow.vtu")
    with pytest.raises(InputError, match="lie on one side of their edge|goes on beyond"):
        load_mesh(tmp_path / "bow.vtu")
    triangle = np.roll([1, 4, 2, 2], turn)[::sense]
    meshio.Mesh(HOUSE, [("quad", [[0, 1, 2, 3], triangle])]).write(tmp_path / "house.vtu")
    house = load_mesh(tmp_path / "house.vtu")
    assert (size(house), len(house.triangles)) == (pytest.approx(150), 3)


SOLID = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
SOLID = np.concatenate([SOLID, SOLID + np.eye(3)[2], [[0.5, 0.5, 1.5]]])


@pytest.mark.parametrize(
    ("cells", "named"),
    [
        ([("tetra", [[0, 1, 2, 4]]), ("polyhedron8", [list(range(8))])], "polyhedron8"),
        ([("triangle", [[0, 1, 2]]), ("polygon", [[0, 2, 3]])], "polygon"),
        ([("triangle", [[0, 1, 2]]), ("polygon", [[0, 1, 2, 3, 4]])], "polygon"),
        ([("vertex", [[0]])], "vertex"),
    ],
)
def test_no_kind_of_cell_is_dropped(tmp_path, monkeypatch, cells, named):
    monkeypatch.setattr(meshio, "read", lambda path, file_format: meshio.Mesh(SOLID, cells))
    (tmp_path / "some.vtu").write_text("")
    with pytest.raises(InputError, match=f"and no other cells, got {named}"):
        load_mesh(tmp_path / "some.vtu")


@pytest.mark.parametrize("seed", range(4))
def test_hexahedra_prisms_and_pyramids_are_cut_so_that_their_sides_meet(tmp_path, seed):
    """Whatever the numbers of the corners: a cube, beside it two prisms, a pyramid on top."""
    order = np.random.default_rng(seed).permutation(11)
    x = np.empty((11, 3))
    x[order] = np.concatenate([SOLID, [[2, 0, 0], [2, 0, 1]]])
    cells = [
        ("hexahedron", order[[[0, 1, 2, 3, 4, 5, 6, 7]]]),
        ("wedge", order[[[1, 9, 2, 5, 10, 6]]]),
        ("pyramid", order[[[4, 5, 6, 7, 8]]]),
        ("quad", order[[[0, 3, 7, 4]]]),
        ("triangle", order[[[1, 9, 2]]]),
    ]
    tags = [np.zeros(1, int), *(np.array([0]) for _ in range(2)), np.array([3]), np.array([4])]
    meshio.Mesh(x, cells, cell_data={"medit:ref": tags}).write(tmp_path / "some.vtu")
    body = load_mesh(tmp_path / "some.vtu")
    volume = np.abs(np.linalg.det(body.x[body.cells[:, 1:]] - body.x[body.cells[:, :1]]))
    assert volume.sum() / 6 == pytest.approx(1 + 0.5 + 1 / 6, rel=1e-14)
    assert len(body.cells) == 6 + 3 + 2
    assert {name: len(part) for name, part in body.parts.items()} == {"3": 2, "4": 1, REST: 15}
    faces = body.x[body.faces]
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    area = np.linalg.norm(normal, axis=1).sum() / 2
    assert area == pytest.approx(6 + 2 * 2**0.5, rel=1e-14)  # none inside


def test_a_hexahedron_with_corners_twice_is_a_prism_and_its_midpoints_are_passed_over(tmp_path):
    prism = [[0, 1, 2, 2, 4, 5, 6, 6]]
    meshio.Mesh(SOLID, [("hexahedron", prism)]).write(tmp_path / "prism.vtu")
    assert len(load_mesh(tmp_path / "prism.vtu").cells) == 3
    many = np.concatenate([SOLID[:8], SOLID[[0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3]] + 0.25])
    meshio.Mesh(many, [("hexahedron20", [list(range(20))])]).write(tmp_path / "second.vtu")
    second = load_mesh(tmp_path / "second.vtu")
    assert (len(second.x), len(second.cells)) == (8, 6)


@pytest.mark.parametrize("seed", range(6))
def test_hexahedra_whose_corners_lie_at_one_place_are_cut_alike(tmp_path, seed):
    """As of two parts that were meshed by themselves; the part between them is inside."""
    order = np.random.default_rng(seed).permutation(16)
    x = np.empty((16, 3))
    x[order] = np.concatenate([SOLID[:8], np.add(SOLID[:8], [1, 0, 0])])
    cells = [("hexahedron", order.reshape(2, 8)), ("quad", order[[[8 + n for n in (1, 2, 6, 5)]]])]
    tags = [np.zeros(2, int), np.array([4])]
    meshio.Mesh(x, cells, cell_data={"medit:ref": tags}).write(tmp_path / "two.vtu")
    with pytest.warns(UserWarning, match="4 of 16 corners"):
        body = load_mesh(tmp_path / "two.vtu")
    assert len(body.x) == 12
    volume = np.abs(np.linalg.det(body.x[body.cells[:, 1:]] - body.x[body.cells[:, :1]]))
    assert volume.sum() / 6 == pytest.approx(2, rel=1e-14)
    assert {name: len(part) for name, part in body.parts.items()} == {"4": 2, REST: 18}


def test_a_cell_that_vanishes_is_not_left_out_without_a_word(tmp_path):
    cells = [("hexahedron", [[0, 1, 2, 3, 4, 5, 6, 7], [4, 5, 6, 7, 4, 5, 6, 7]])]
    meshio.Mesh(SOLID, cells).write(tmp_path / "flat.vtu")
    with pytest.raises(InputError, match="number 1 of those with 8 corners has no volume"):
        load_mesh(tmp_path / "flat.vtu")


LINES = {"left": [[0, 1], [1, 2]], "right": [[6, 7], [7, 8]], "low": [[0, 3], [3, 6]]}
NINE, FOUR = grid(2, 2)
TRIANGLES = np.concatenate([FOUR[:, part] for part in HALVES])
FLAT = np.column_stack([NINE, np.zeros(9)])


def gmsh22(path, tags, names=()):
    """A file of Gmsh's as it writes elements of several groups: once for each."""
    rows = []
    for tag, lines in tags:
        rows += [f"1 2 {tag} 1 {a + 1} {b + 1}" for a, b in lines]
    for tag in (20, 21):
        rows += [f"2 2 {tag} 1 " + " ".join(str(c + 1) for c in cell) for cell in TRIANGLES]
    text = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat"]
    if names:
        text += ["$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames"]
    text += ["$Nodes", "9", *(f"{n + 1} {a} {b} 0" for n, (a, b) in enumerate(NINE)), "$EndNodes"]
    text += ["$Elements", str(len(rows)), *(f"{n + 1} {row}" for n, row in enumerate(rows))]
    path.write_text("\n".join([*text, "$EndElements"]) + "\n")


def test_groups_keep_their_numbers_and_elements_all_their_groups(tmp_path):
    tags = [(11, LINES["left"]), (12, LINES["right"]), (7, LINES["left"][:1] + LINES["low"])]
    gmsh22(tmp_path / "a.msh", [*tags, (0, [[2, 5]])], ['1 12 "pulled"', '2 20 "sheet"'])
    mesh = load_mesh(tmp_path / "a.msh")
    assert {name: len(part) for name, part in mesh.parts.items()} == {
        "11": 2, "pulled": 2, "7": 3, REST: 2,
    }  # fmt: skip
    assert size(mesh) == 4
    assert len(np.intersect1d(mesh.parts["11"], mesh.parts["7"])) == 1


def test_bounding_entities_are_no_part_and_named_groups_of_an_element_are_kept(tmp_path):
    entities = ["0 4 1 0"]
    entities += [f"{n} 0 0 0 2 2 0 {len(g)} {' '.join(map(str, g))} 2 1 -2" for n, g in (
        (1, (11, 13)), (2, (12,)), (3, ()), (4, (13,)))]  # fmt: skip
    entities += ["1 0 0 0 2 2 0 1 20 4 1 2 3 4"]
    blocks = []
    for number, lines in ((1, LINES["left"]), (2, LINES["right"]), (4, LINES["low"])):
        blocks += [
            f"1 {number} 1 2",
            *(f"{9 * number + n} {a + 1} {b + 1}" for n, (a, b) in enumerate(lines)),
        ]
    blocks += [f"2 1 2 {len(TRIANGLES)}"]
    blocks += [
        f"{90 + n} " + " ".join(str(c + 1) for c in cell) for n, cell in enumerate(TRIANGLES)
    ]
    text = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$PhysicalNames", "3", '1 11 "left"',
            '1 13 "both"', '2 20 "sheet"', "$EndPhysicalNames", "$Entities", *entities,
            "$EndEntities", "$Nodes", "1 9 1 9", "2 1 0 9", *map(str, range(1, 10)),
            *(f"{a} {b} 0" for a, b in NINE), "$EndNodes", "$Elements", "4 14 1 99", *blocks,
            "$EndElements"]  # fmt: skip
    (tmp_path / "a.msh").write_text("\n".join(text) + "\n")
    mesh = load_mesh(tmp_path / "a.msh")
    assert {name: len(part) for name, part in mesh.parts.items()} == {
        "left": 2, "both": 4, "12": 2, REST: 2,
    }  # fmt: skip


@pytest.mark.parametrize("key", ["medit:ref", "cell_tags"])
def test_numbers_of_converted_files_are_parts(tmp_path, key):
    lines, tags = np.array(LINES["left"] + LINES["right"]), np.array([5, 5, 6, 6])
    meshio.Mesh(
        FLAT,
        [("line", lines), ("triangle", TRIANGLES)],
        cell_data={key: [tags, np.zeros(len(TRIANGLES), int)]},
    ).write(tmp_path / "a.vtu")
    mesh = load_mesh(tmp_path / "a.vtu")
    assert {name: len(mesh.parts[name]) for name in ("5", "6")} == {"5": 2, "6": 2}
    assert set(mesh.parts) == {"5", "6", REST}


def test_lines_inside_are_left_out_of_files_with_a_word(tmp_path):
    gmsh22(tmp_path / "a.msh", [(1, [*LINES["left"], [1, 4]]), (2, [[4, 7]])])
    with pytest.warns(UserWarning, match="edges of the outline, 1 of . are not and are left out"):
        mesh = load_mesh(tmp_path / "a.msh")
    assert {name: len(part) for name, part in mesh.parts.items()} == {"1": 2, REST: 6}
    for wrong in ([[0, 99]], [[-1, 0]], [[0, 2]]):
        with pytest.raises(InputError, match="part 'a': expected edges of the outline, 1 of 1"):
            make_mesh(NINE, TRIANGLES, {"a": wrong})
    with pytest.raises(InputError, match="part 'a': expected int values, got float64"):
        make_mesh(NINE, TRIANGLES, {"a": [[0.0, 1.0]]})
    with pytest.raises(InputError, match="part 'a': expected faces of the surface, 1 of 1"):
        make_tetrahedra(SOLID[:8], np.arange(8)[np.array(SIXTHS)], {"a": [[0, 1, 6]]})


@pytest.mark.parametrize("gap", [30.0, 0.0], ids=["apart", "at a corner"])
def test_every_piece_of_a_body_is_held(gap):
    model = kernel("positive", 2.5)
    one, two = grid(6, 6, size=5.0), grid(6, 6, size=5.0, origin=30.0 + gap)
    x, blocks = joined(one, two)
    if not gap:
        blocks = np.where(blocks == len(one[0]), len(one[0]) - 1, blocks)
    cells = np.concatenate([blocks[:, part] for part in HALVES])
    ends = [[a, a + 1] for a in range(6)]
    last = [[a + 42 + 49, a + 43 + 49] for a in range(6)]
    mesh = make_mesh(x, cells, {"left": ends, "right": last})
    coupling = Coupling(spacing=1.0)

    def solved(held):
        with pytest.warns(UserWarning, match="by elements alone"):
            return wp.solve(model, wp.Body(mesh, held, coupling=coupling), allow_uncertified=True)

    with pytest.raises(InputError, match="against shifts and turns, got left; the mesh is of 2"):
        wp.solve(model, wp.Body(mesh, {"left": (0, 0)}, coupling=coupling), allow_uncertified=True)
    assert np.abs(solved({"left": (0, 0), "right": (0.1, 0)}).u).max() == pytest.approx(0.1)
