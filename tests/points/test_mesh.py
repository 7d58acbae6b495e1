"""Meshes of bodies: outlines, files, what is mended with a word and what is refused."""

import contextlib
from dataclasses import replace
from itertools import permutations

import meshio
import numpy as np
import torch
from numpy import array, eye, pi
from numpy.linalg import det, norm
from numpy.testing import assert_allclose, assert_array_equal

import warp_peri as wp
from tests.support import approx, filterwarnings, in_plane_and_space, parametrize, sup
from tests.support.problems import kernel
from tests.support.told import assert_refused, each_refused, refused, warned
from warp_peri.errors import InputError
from warp_peri.points.mesh import REST, make_mesh, pieces
from warp_peri.points.mesh_files import load_mesh
from warp_peri.points.outlines import Circle, Polygon, box, mesh_outline

HALVES = [[0, 1, 2], [0, 2, 3]]
SIXTHS = []
for order in permutations(eye(3, dtype=int).tolist()):
    walk = np.cumsum([(0, 0, 0), *order], axis=0)
    turn = {(0, 0): 0, (1, 0): 1, (1, 1): 2, (0, 1): 3}
    SIXTHS.append([turn[x, y] + 4 * z for x, y, z in walk.tolist()])
counts = lambda mesh: {name: len(part) for name, part in mesh.parts.items()}
NODES = "*NODE\n" + "".join(
    f"{10 * n + 1}, {x}., {y}.\n"
    for n, (x, y) in enumerate([(0, 0), (3, 0), (6, 0), (0, 2), (3, 2), (6, 2)])
)
CELLS = "*ELEMENT, TYPE=CPS4R, ELSET=plate\n7, 1, 11, 41,\n31\n9, 11, 21, 51, 41\n"
PLATE = f"*HEADING\nA plate, 12 of area\n{NODES}{CELLS}"
PART = f"*PART, NAME=P\n{NODES}{CELLS}*END PART\n*ASSEMBLY, NAME=A\n"
INSTANCE = "*INSTANCE, NAME={}, PART=P\n{}*END INSTANCE\n"


def grid(*sides, size=1.0, origin=0.0):
    """Corners of squares or cubes, and these by their corners in turn."""
    steps = np.stack(np.meshgrid(*[np.arange(n + 1) for n in sides], indexing="ij"), -1)
    number = np.arange(steps[..., 0].size).reshape(steps.shape[:-1])
    turns = ((0, 0), (1, 0), (1, 1), (0, 1))
    turns = turns if len(sides) == 2 else [(*p, z) for z in (0, 1) for p in turns]
    cells = [number[tuple(slice(o, o + n) for o, n in zip(p, sides))].ravel() for p in turns]
    return origin + size * steps.reshape(-1, len(sides)).astype(float), np.stack(cells, axis=1)


def body(x, blocks):
    """The mesh of squares cut in two, or cubes in six."""
    parts = HALVES if x.shape[1] == 2 else SIXTHS
    return make_mesh(x, np.concatenate([blocks[:, part] for part in parts]))


def size(mesh):
    corners = mesh.x[mesh.cells]
    return np.abs(det(corners[:, 1:] - corners[:, :1])).sum() / (2, 6)[mesh.dimension - 2]


def joined(*grids):
    """Grids in one mesh, each with corners of its own."""
    first = np.cumsum([0, *(len(x) for x, _ in grids)])
    cells = [cells + n for (_, cells), n in zip(grids, first)]
    return np.concatenate([x for x, _ in grids]), np.concatenate(cells)


@parametrize("unit", [2.0**-40, 8.0, 2.0**40])
def test_an_outline_has_one_mesh_in_any_unit(unit):
    def made(h):
        return mesh_outline(box(70 * h, 60 * h), [Circle(9 * h, (3 * h, h), size=h)], size=4 * h)

    first, mesh = made(1.0), made(unit)
    assert np.array_equal(mesh.cells, first.cells)
    assert np.array_equal(mesh.x, unit * first.x)


def test_an_outline_has_its_parts_curves_holes_and_distances():
    mesh = mesh_outline(box(40, 30), [Circle(5, (3, 1), size=1)], size=4)
    assert set(mesh.parts) == {"bottom", "right", "top", "left", "hole"}
    assert_allclose(mesh.hole_sizes, [10], rtol=1e-2)
    for x in (mesh.x[mesh.faces[mesh.parts["hole"]][:, 0]], mesh.middle[mesh.parts["hole"]]):
        assert_allclose(norm(x - (3, 1), axis=1), 5, rtol=1e-6)
    assert size(mesh) == approx(40 * 30 - pi * 25, rel=1e-2)
    assert_allclose(mesh.distance(array([[0.0, 14.0], [9.0, 1.0]]), 0.01), [1, 1], atol=1e-3)
    assert (mesh.holding(array([[3.0, 1], [21, 0]])) == -1).all()
    corners = ((0, 0), (10, 0), (10, 4), (4, 4), (4, 10), (0, 10))
    matrix = array(corners[::-1]).view(np.matrix)
    for given in (
        array(corners[::-1], "u1"),
        matrix,
        torch.tensor(matrix),
        (*corners, (1e-12, -1e-12)),
    ):
        assert size(mesh_outline(Polygon(given), size=2)) == approx(64)
    hole = Polygon(((0, 0), (3, 0), (0, 3)), ("cut",))
    assert set(mesh_outline(Circle(10, name="edge"), [hole], size=1).parts) == {"edge", "cut"}
    assert_refused({
        "holes: expected holes inside": lambda: mesh_outline(box(10, 10), [Circle(6)], size=1),
        "1 / radius: expected finite": lambda: Circle(1e-300),
        "that meet nothing": lambda: mesh_outline(box(9, 9), [Circle(2), Circle(1)], size=1),
        r"centre: expected shape \[2\], got \[3\]": lambda: Circle(1.0, (0.0, 0.0, 0.0)),
        "names: expected 6 texts, one a side, got": (
            lambda: Polygon(corners, ("a", "b")), lambda: Polygon(corners, (None,) * 6),
        ),
        "corners: expected three at least, got 2": lambda: Polygon(corners[:2]),
        "corners around an area, got 0": lambda: Polygon(((0, 0), (1, 0), (2, 0))),
        "corners: expected sides apart, 0 and 2 meet": (
            lambda: Polygon(((0, 0), (9, 9), (9, 0), (0, 12))),
            lambda: Polygon(((0, 0), (9, 0), (15, 0), (9, 0), (0, 9))),
        ),
        "size: expected at most": (
            lambda: mesh_outline(box(200, 200), size=1e-3),
            lambda: mesh_outline(box(9, 9), [Circle(2, size=1e-6)], size=1),
        ),
    })  # fmt: skip


@parametrize(("sides", "scale"), [((4, 3), 1e-6), ((3, 2, 2), 1e6)])
def test_corners_at_one_place_are_one_and_a_word_says_so(sides, scale):
    d, (x, blocks) = len(sides), grid(*sides, size=scale)
    whole = body(x, blocks)
    turn = det(whole.x[whole.faces])  # of the outline, whose body is on its left
    assert turn.sum() == approx(d * (d - 1) * np.prod(sides) * scale**d)
    apart = x[blocks].reshape(-1, d)
    with warned(f"{len(apart) - len(x)} of {len(apart)} corners lie"):
        welded = body(apart, np.arange(len(apart)).reshape(blocks.shape))
    assert (len(welded.x), len(welded.faces)) == (len(x), len(whole.faces))
    assert set(pieces(welded.cells)) == {0}


@filterwarnings("ignore:mesh. .* lie where others do")
@in_plane_and_space
def test_cells_that_overlap_or_share_parts_of_facets_are_refused(d):
    for ratio, count, shift, words in (
        (0.5, 4, [2.0, 0.0, 0.0], "goes on beyond"),  # small beside large: hanging
        (0.3, 2, [0.53, 0.13, 0.13], "goes on beyond"),  # one within the other
        (1.0, 2, [0.0, 0.0, 0.0], "one or two at each .*, some (edge|face) has more"),  # twice
    ):
        x, small = grid(*d * [count], size=ratio * 1e-6)
        with refused(words):
            body(*joined(grid(*d * [2], size=1e-6), (x + 1e-6 * array(shift[:d]), small)))


def test_a_crack_with_a_width_is_an_outline_and_one_without_is_closed():
    x, blocks = grid(4, 4)
    crack = (x[:, 0] < 2) & (x[:, 1] == 2)
    number = np.where(crack, len(x) + np.cumsum(crack) - 1, np.arange(len(x)))
    above = x[blocks].mean(1)[:, 1] > 2
    blocks[above] = number[blocks[above]]
    assert len(body(np.concatenate([x, x[crack] + [0, 0.01]]), blocks).faces) == 16 + 4
    with warned("2 of 27 corners .* a crack needs a width"):
        assert len(body(np.concatenate([x, x[crack]]), blocks).faces) == 16


NINE, FOUR = grid(2, 2)
TRIANGLES = np.concatenate([FOUR[:, part] for part in HALVES])
CUBE, EIGHT = grid(1, 1, 1)
LINES = {"left": [[0, 1], [1, 2]], "right": [[6, 7], [7, 8]], "low": [[0, 3], [3, 6]]}


def test_what_is_no_mesh_of_a_body_is_refused():
    square = array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    each_refused(make_mesh, {
        "0 and 1 lie on one side of their": (square, [[0, 1, 2], [0, 2, 1]]),
        "number 0 has no area": (square, [[0, 1, 1]]),
        "tetrahedra: number 0 has no volume": (CUBE, [[0, 2, 4, 6]]),
        "part 'a': expected edges of the outline, 1 of 1": (NINE, TRIANGLES, {"a": [[1, 4]]}),
        r"part 'a': expected shape \[n, 2\]": (square, HALVES, {"a": [[0, 1, 2]]}),
        "part 'a': expected an array": (square, HALVES, {"a": [[0], [1, 2]]}),
        "part 'a': expected finite .*; at most 9": (square, HALVES, {"a": array([[2**63] * 2])}),
        "faces of the surface, 1 of 1": (CUBE, EIGHT[0][SIXTHS], {"a": [EIGHT[0][[0, 1, 6]]]}),
        "middle: expected": (square, HALVES, {}, {(0, 1): -1.0}),
        "middle: expected .*": (square, HALVES, {}, {(0, 9): (0.5, 0.0)}),
        **{f"middle: expected {words}": (square, HALVES, {}, {key: (0.5, 0.0)})
           for words, key in ((r"shape \[n, 2\]", 5), ("int values", "ab"))},
    })  # fmt: skip


def test_a_mesh_holds_what_was_checked_each_face_of_a_part_once():
    made = make_mesh(NINE, TRIANGLES, {"left": LINES["left"]})
    twice = {"left": [*made.parts["left"]] * 2}
    mesh = wp.Mesh(made.x.tolist(), np.ma.array(made.cells), made.faces, made.middle, twice)
    assert "left (2)" in repr(mesh)
    with refused("triangles: expected corners around an area or volume, not 1"):
        wp.Mesh(made.x, [made.cells[0], [0, 0, 1]], made.faces, made.middle)
    with refused("triangles: expected some, got none"):
        replace(made, cells=made.cells[:0])


def test_a_file_of_second_order_keeps_the_curve(tmp_path):
    x, tags = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, -0.3, 0], [1, 1, 0], [0, 1, 0]], [[7], [8]]
    written = meshio.Mesh(
        array(x), [("line", [[0, 1]]), ("triangle6", [[0, 1, 2, 3, 4, 5]])],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"bent": array([7, 1])},
    )  # fmt: skip
    written.write(tmp_path / "a.msh", file_format="gmsh22", binary=False)
    written.cell_data, written.field_data = {}, {}
    written.write(tmp_path / "a.vtu")
    named = wp.load(tmp_path / "a.msh")
    with warned("none of the 1 lines in the file is in a group"):
        bare = wp.load(tmp_path / "a.vtu")
    assert (counts(named), counts(bare)) == ({"bent": 1, REST: 2}, {REST: 3})
    for one, part in ((named, "bent"), (bare, REST)):
        assert len(one.x) == 3
        assert_allclose(one.middle[one.parts[part][0]], [1, -0.3])


def test_quadrilaterals_are_cut_where_they_are_turned_in(tmp_path):
    kite = array([[0.0, 0, 0], [10, 4, 0], [20, 0, 0], [10, 20, 0]])
    corners = array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [20, 5, 0]])

    def read(x, *quads):
        meshio.Mesh(x, [("quad", quads)]).write(tmp_path / "a.vtu")
        return load_mesh(tmp_path / "a.vtu")

    for turn, sense in ((0, 1), (1, -1)):
        quad, triangle = (np.roll(ends, turn)[::sense] for ends in ([0, 1, 2, 3], [1, 4, 2, 2]))
        assert size(read(kite, quad)) == approx(160)
        with refused("lie on one side of their edge|goes on beyond"):
            read(corners, quad[[0, 2, 1, 3]])
        house = read(corners, [0, 1, 2, 3], triangle)
        assert (size(house), len(house.cells)) == (approx(150), 3)


def test_no_kind_of_cell_is_dropped(tmp_path):
    tetra, path = ("tetra", [[0, 1, 2, 4]]), tmp_path / "some.vtk"
    for named, cells in (("hexahedron", [[*range(8)]]), ("quad", [[0, 1, 3, 2]])):
        meshio.Mesh(CUBE, [tetra, (named, cells)]).write(path)
        with refused(f"and no other cells, got {named}"):
            load_mesh(path)


FLAT = np.pad(NINE, ((0, 0), (0, 1)))


def gmsh22(path, groups, **names):
    """A file of Gmsh's, elements of several groups once for each."""
    groups = [(tag, "line", lines) for tag, lines in groups]
    groups += [(tag, "triangle", TRIANGLES) for tag in (20, 21)]
    tags = [np.full(len(cells), tag) for tag, _, cells in groups]
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    blocks = [(kind, cells) for _, kind, cells in groups]
    mesh = meshio.Mesh(FLAT, blocks, cell_data=data, field_data=names)
    mesh.write(path, file_format="gmsh22", binary=False)
    return load_mesh(path)


def test_groups_keep_their_numbers_and_elements_all_their_groups(tmp_path):
    groups = [(11, LINES["left"]), (12, LINES["right"]), (7, LINES["left"][:1] + LINES["low"])]
    names = {"pulled": array([12, 1]), "sheet": array([20, 2])}
    mesh = gmsh22(tmp_path / "a.msh", [*groups, (0, [[2, 5]])], **names)
    assert counts(mesh) == {"11": 2, "pulled": 2, "7": 3, REST: 2}
    assert size(mesh) == 4
    assert len(np.intersect1d(mesh.parts["11"], mesh.parts["7"])) == 1
    with warned("edges of the outline, 1 of . are not and are left out"):
        mesh = gmsh22(tmp_path / "b.msh", [(1, [*LINES["left"], [1, 4]]), (2, [[4, 7]])])
    assert counts(mesh) == {"1": 2, REST: 6}


def test_bounding_entities_are_no_part_and_named_groups_of_an_element_are_kept(tmp_path):
    entities = ["0 4 1 0"]
    entities += [f"{n} 0 0 0 2 2 0 {len(g)} {' '.join(map(str, g))} 2 1 -2" for n, g in (
        (1, (11, 13)), (2, (12,)), (3, ()), (4, (13,)))]  # fmt: skip
    entities += ["1 0 0 0 2 2 0 1 20 4 1 2 3 4"]
    blocks = []
    for number, lines in ((1, LINES["left"]), (2, LINES["right"]), (4, LINES["low"])):
        rows = [f"{9 * number + n} {a + 1} {b + 1}" for n, (a, b) in enumerate(lines)]
        blocks += [f"1 {number} 1 2", *rows]
    cells = [f"{90 + n} " + " ".join(str(c + 1) for c in cell) for n, cell in enumerate(TRIANGLES)]
    text = ["$MeshFormat", "4.1 0 8", "$EndMeshFormat", "$PhysicalNames", "3", '1 11 "left"',
            '1 13 "both"', '2 20 "sheet"', "$EndPhysicalNames", "$Entities", *entities,
            "$EndEntities", "$Nodes", "1 9 1 9", "2 1 0 9", *map(str, range(1, 10)),
            *(f"{a} {b} 0" for a, b in NINE), "$EndNodes", "$Elements", "4 14 1 99", *blocks,
            f"2 1 2 {len(cells)}", *cells, "$EndElements"]  # fmt: skip
    (tmp_path / "a.msh").write_text("\n".join(text) + "\n")
    assert counts(load_mesh(tmp_path / "a.msh")) == {"left": 2, "both": 4, "12": 2, REST: 2}


def test_numbers_of_converted_files_are_parts(tmp_path):
    lines = ("line", array(LINES["left"] + LINES["right"])), ("triangle", TRIANGLES)
    sides = ("tetra", EIGHT[0][SIXTHS]), ("triangle", EIGHT[0][HALVES])
    for x, cells, tags, known in (
        (FLAT, lines, ([5, 5, 6, 6], 8 * [0]), {"5": 2, "6": 2, REST: 4}),
        (CUBE, sides, (6 * [0], [3, 4]), {"3": 1, "4": 1, REST: 10}),
    ):
        groups = {"medit:ref": [array(one) for one in tags]}
        meshio.Mesh(x, cells, cell_data=groups).write(tmp_path / "a.vtu")
        assert counts(mesh := load_mesh(tmp_path / "a.vtu")) == known
    assert size(mesh) == approx(1)


def abaqus(tmp_path, text):
    (tmp_path / "a.inp").write_text(text)
    return wp.load(tmp_path / "a.inp")


def test_sets_of_nodes_and_of_lines_of_abaqus_are_parts(tmp_path):
    """Whatever blocks they lie in: each is where its corners are, whatever its name's case."""
    text = PLATE + (
        "*NODE\n2, 1.5d0, 0.+0\n3, 45.-1, 0.E+0\n"
        "*ELEMENT, TYPE=B22, ELSET=low\n21, 1, 2, 11\n"
        "*ELEMENT, TYPE=T2D3, ELSET=LOW\n22, 11, 21, 3\n"
        "*ELEMENT, TYPE=T2D2\n23, 21, 51\n*ELEMENT, TYPE=B21\n24, 51, 41\n"
        "*ELSET,\n ELSET=right\n23\n*ELSET, ELSET=two\nRIGHT, 24\n"
        "*NSET, NSET=Left\n1\n*NSET, NSET=LEFT\n31\n*NSET, NSET=top, GENERATE\n31, 51, 10\n"
        "*NSET, NSET=corner\n1\n"
    )
    with warned("corner: no side of the outline is between its nodes"):
        mesh = abaqus(tmp_path, text)
    assert size(mesh) == approx(12)
    found = counts(mesh) | {REST: 0}
    assert found == {"low": 2, "right": 1, "two": 2, "Left": 1, "top": 2, REST: 0}
    for name, axis, value in (("low", 1, 0), ("Left", 0, 0), ("right", 0, 6), ("top", 1, 2)):
        assert_allclose(mesh.x[mesh.faces[mesh.parts[name]]].mean(1)[:, axis], value)
    tetra = "*NODE\n1, 0, 0, 0\n2, 2, 0,\n3, , 3, 0\n4, , , 1\n*NSET, NSET=low\n1, 2, 3\n"
    mesh = abaqus(tmp_path, tetra + "*ELEMENT, TYPE=C3D4\n1, 1, 2, 3, 4\n")
    assert size(mesh) == approx(1)
    assert_array_equal(mesh.x[mesh.faces[mesh.parts["low"]]][..., 2], 0)


def test_one_part_that_is_placed_where_it_is(tmp_path):
    """As CAE writes it, with sets in the assembly, a material, a second block of nodes, a step."""
    rows = NODES.splitlines(keepends=True)
    text = (
        "*Heading\n*Part, name=P\n" + "".join(rows[:4]) + "*Node\n" + "".join(rows[4:]) + CELLS
        + "*Nset, nset=inner, internal\n1, 31\n"
        "*Solid Section, elset=plate, material=m\n1.,\n*End Part\n*Assembly, name=A\n"
        "*Instance, name=I, part=P\n*End Instance\n"
        "*Nset, nset=left, instance=I\n1, 31\n*End Assembly\n*Material, name=m\n*Elastic\n1., .3\n"
        "*Step\n*Boundary\nleft, 1, 2\n*End Step\n"
    )  # fmt: skip
    with warned(r"not read: \*SOLID SECTION, \*MATERIAL, \*ELASTIC, \*STEP"):
        mesh = abaqus(tmp_path, text)
    assert size(mesh) == approx(12)
    assert_allclose(mesh.x[mesh.faces[mesh.parts["left"]]].mean(1), [[0, 1]])


def test_what_is_not_read_is_refused_by_name(tmp_path):
    each_refused(lambda text: abaqus(tmp_path, text), {
        r"\*INSTANCE: expected one": PART + INSTANCE.format("I", "") + INSTANCE.format("J", ""),
        r"\*INSTANCE: .* one that is not moved": PART + INSTANCE.format("I", "10., 0., 0.\n"),
        r"\*NODE, SYSTEM is not read": PLATE.replace("*NODE", "*NODE, SYSTEM=C"),
        r"\*SYSTEM is not read": PLATE.replace("*NODE", "*SYSTEM\n0,0,0,0,1,0\n*NODE"),
        **{rf"\*{word} is not read": PLATE + f"*{word}, ANY=1\n1, 31, 10\n"
           for word in ("NGEN", "INCLUDE", "TIE")},
        r"\*NSET, ELSET is not read": PLATE + "*NSET, NSET=a, ELSET=plate\n",
        r"\*NSET, a: 77 is not there": PLATE + "*NSET, NSET=a\n77\n",
        r"\*ELEMENT: expected each number once": PLATE + CELLS,
        "TYPE=C3D8 is not read; tetrahedra": PLATE.replace("CPS4R", "C3D8"),
        "TYPE=CPS6: expected 6 nodes of each": PLATE.replace("CPS4R", "CPS6"),
        r"\*ELEMENT: expected nodes that are there, got 52": PLATE.replace("51, 41", "52, 41"),
        "got nothing": NODES,
        "not a mesh of abaqus": PLATE + "*NSET\n1\n",
        "a mesh of abaqus": PLATE + "*NSET, NSET=a, GENERATE\n1, 99999999999, 0\n",
    })  # fmt: skip
    with refused("no such mesh file"):
        load_mesh(tmp_path / "none.msh")
    for name, said in (("a.mesh", "convert it with meshio, then"), ("a.msh", "not a mesh of gmsh"),
                       ("a.vtk", "expected an UNSTRUCTURED_GRID")):  # fmt: skip
        (tmp_path / name).write_text("no mesh")
        with refused(said):
            load_mesh(tmp_path / name)


@filterwarnings("ignore")
def test_cut_files_are_read_or_refused_and_none_waits_for_ever(tmp_path):
    (tmp_path / "a.inp").write_text(PLATE)
    flat = meshio.Mesh(FLAT, [("triangle", TRIANGLES)])
    flat.write(tmp_path / "a.msh", file_format="gmsh22", binary=True)
    flat.write(tmp_path / "a.vtu", binary=False)
    for whole in [*tmp_path.iterdir()]:
        content, cut = whole.read_bytes(), tmp_path / f"cut{whole.suffix}"
        for size in range(0, len(content), len(content) // 15):
            cut.write_bytes(content[:size])
            with contextlib.suppress(InputError):
                wp.load(cut)


@parametrize("gap", [30.0, 0.0])
def test_every_piece_of_a_body_is_held(gap):  # apart, or touching at a corner
    one, two = grid(6, 6, size=5.0), grid(6, 6, size=5.0, origin=30.0 + gap)
    x, blocks = joined(one, two)
    if not gap:
        blocks = np.where(blocks == len(one[0]), len(one[0]) - 1, blocks)
    cells = np.concatenate([blocks[:, part] for part in HALVES])
    ends = [[a, a + 1] for a in range(6)]
    mesh = make_mesh(x, cells, {"left": ends, "right": np.add(ends, 42 + 49)})
    problem = {"mesh": mesh, "coupling": wp.methods.Coupling(spacing=1.0)}

    def solved(held):
        body = wp.Body(displacement=held, **problem)
        return wp.solve(kernel("positive", 2.5), body, allow_uncertified=True)

    with refused("against shifts and turns, got left; the mesh is of 2"):
        solved({"left": (0, 0)})
    with warned("by elements alone"):
        u = solved({"left": (0, 0), "right": (0.1, 0)}).u
    assert sup(u) == approx(0.1)
