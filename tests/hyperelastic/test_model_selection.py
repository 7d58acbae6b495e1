"""A sheet's material chosen by frames left out; what fails is passed over; tension with a band."""

from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
from numpy import array, cos, eye, sin, zeros
from numpy.linalg import det
from numpy.random import default_rng
from numpy.testing import assert_allclose

import warp_peri as wp
from tests.support import approx, of_json, parametrize, refused, slow
from tests.support.sheets import NEAREST, hgo_dictionary, square, waves
from tests.support.solving import solve
from tools import make_frames
from tools.hyperelastic_elements import Elements, finite_elements, square_mesh
from tools.hyperelastic_energies import Family, plane_stress_hgo
from warp_peri.atoms.dic import DICFrame, dic_to_lattice
from warp_peri.cli.main import main
from warp_peri.hyperelastic import (
    Candidate,
    EnergyTerm,
    Hyperelastic,
    HyperelasticMaterial,
    SheetFit,
    material_terms,
    select_model,
    uniaxial_stress,
)
from warp_peri.materials.hyperelastic import model_selection
from warp_peri.materials.hyperelastic.model_selection import febio_material, in_words, save_febio
from warp_peri.points.outlines import Circle, box, mesh_outline
from warp_peri.points.points import grid_places

C1, C2 = 0.35, 0.15
curves_of = lambda out: np.loadtxt(out / "curves.csv", delimiter=",", skiprows=1, unpack=True)
"""Stretches, then stress and both ends of its band along each direction."""
HGO = HyperelasticMaterial(hgo_dictionary(), array([0.3] * 4 + [0.0713, 0.0780, 0.2]), 0.1)
"""Its deviations vanish in uniform strain."""


def solid(*terms):
    """A sheet of terms with coefficients."""
    terms, c = zip(*terms)
    return HyperelasticMaterial(Hyperelastic(3.0, NEAREST, terms), array([0.1] * 4 + [*c]), 0.1)


SHEET = solid((EnergyTerm("plane_stress"), C1), (EnergyTerm("mooney"), C2))
tension = lambda s, c1=C1, c2=C2: 2 * (s - s**-2) * (c1 + c2 / s)
"""Nominal stress of Mooney and Rivlin's sheet in uniaxial tension."""


def fields_of(material, points, bent):
    """Six fields of a sheet that is pulled and bent more and more."""
    edges = [points.x @ bent * (n + 3) / 8 + 0.6 * waves(points, 0.25, n) for n in range(6)]
    return [solve(material, points, None, edge) for edge in edges]


def table(folder, x, fields):
    """Frames as tables in mm."""
    for number, u in enumerate(fields):
        rows = "\n".join(",".join(map(str, row)) for row in np.hstack([x, u]))
        (folder / f"frame{number}.csv").write_text("x [mm],y [mm],u [mm],v [mm]\n" + rows + "\n")


def command(folder, out, *options):
    """What `fit-sheet` says in its file, or its status where that is not 0."""
    status = main(["fit-sheet", str(folder), "--even", "--out", str(out), *options])
    return status or of_json(out / "sheet.json")


def test_uniaxial_tension_is_that_of_the_formula():
    stretches = array([1.3, 1.3, 3.0, 1.01, 0.8])
    for angle in (0.0, 0.7):
        assert_allclose(uniaxial_stress(SHEET, stretches, angle), tension(stretches), rtol=1e-8)
    slope, first = stretches - stretches**-2, stretches**2 + 2 / stretches - 3
    for p in (2.0, 3.0):  # powers of I1 − 3
        found = uniaxial_stress(solid((EnergyTerm("yeoh", exponent=p), 0.7)), stretches)
        assert_allclose(found, 2 * 0.7 * p * slope * first ** (p - 1), rtol=1e-8)


def test_the_command_passes_over_what_fails(tmp_path, monkeypatch):
    fit, points, out = model_selection.fit_sheet, square(8), tmp_path / "out"
    table(tmp_path, points.x, fields_of(SHEET, points, array([[0.3, 0.05], [0.0, 0.1]])))

    def broken(train, dictionary, **options):
        if len(dictionary.terms) == 1:
            raise RuntimeError("Factor is exactly singular")
        return fit(train, dictionary, **options)

    monkeypatch.setattr(model_selection, "fit_sheet", broken)
    assert command(tmp_path, out, "--stress", "0.3", "--pixel", "0.012") == 2  # in which unit?
    found = command(tmp_path, out, "--json", "--stress", "0.3")
    assert (found["material"], found["lengths"]) == ("Mooney-Rivlin", "mm")
    assert "exactly singular" in found["passed_over"][0]
    assert "70 interior nodes for 7 numbers, got 64" in found["passed_over"][1]
    assert found["stresses"].startswith("are in MPa")
    assert any(words.startswith("deviations") for words in found["words"])
    assert (out / "Mooney-Rivlin.json").exists()
    assert "Mooney-Rivlin" in (out / "material.feb").read_text()
    far, near = uniaxial_stress(wp.load(out / "material.json"), [1.4, 1.05])
    assert far / near == approx(tension(1.4) / tension(1.05), rel=0.01)
    _, middle, low, high, *_ = curves_of(out)
    assert ((low <= middle) & (middle <= high)).all()


@slow
def test_an_even_sheet_that_stiffens_is_not_called_uneven():
    """Its tension, to 1.5, lies in the band, whatever points are lost in single frames."""
    powers = [(EnergyTerm("yeoh", exponent=p), c) for p, c in ((2.0, 0.02), (3.0, 0.03))]
    sheet, stretches = solid((EnergyTerm("plane_stress"), 0.25), *powers), [1.1, 1.3, 1.5]
    true = uniaxial_stress(sheet, stretches) / uniaxial_stress(sheet, [1.01])[0]
    points, rng = square(11), default_rng(3)
    u = array(fields_of(sheet, points, array([[0.5, 0.05], [0.0, 0.2]])))
    u += 2e-4 * rng.standard_normal(u.shape)
    kept = rng.uniform(size=u.shape[:2]) >= 0.03
    frames = dic_to_lattice(
        [DICFrame(points.x[k], one[k], "frame", "mm") for one, k in zip(u, kept)], spacing=0.1
    )
    assert frames.interior.sum() == 121
    best = select_model(frames)[0]
    assert best.name == "Yeoh"
    middle, low, high = best.curves(stretches) / uniaxial_stress(best.fit.material, [1.01])[0]
    assert_allclose(middle, true, rtol=0.04)
    assert ((low < true) & (true < high)).all()
    assert (high - low > 2 * best.held_out * middle).all()


def test_a_band_is_no_narrower_than_the_misfit_and_deviations_have_none():
    """Fits that agree exactly, as those of one number do, know no more than the frames tell."""
    even = SheetFit(SHEET, zeros(1), [], [])
    middle, low, high = Candidate("one", replace(even, others=[even] * 3), 0.01).curves([1.2])
    assert_allclose(high - low, 2 * 1.645 * 0.01 * middle, rtol=1e-3)
    stiff = replace(SHEET, coefficients=array([282.0] * 4 + [0.4, 0.1]))
    rules = Candidate("rules", replace(even, material=stiff), 0.01)
    with refused("282 times as stiff .* in the place of a material"):
        rules.curves([1.2])
    with refused("level: expected a number between 0 and 1"):
        rules.curves([1.2], level=90)


def stretched(mesh, energy, fixed, given, x, levels):
    """Fields of elements at parts of what is given, with noise of 0.002 spacings, and forces."""
    rng, u, fields, forces = default_rng(5), None, [], []
    for level in levels:
        u = mesh.solve(energy, zeros(2 * mesh.nodes), fixed, level * given, start=u, steps=2)
        fields.append(mesh.sample(u, x) + 2e-4 * rng.standard_normal(x.shape))
        forces.append(mesh.forces(mesh.state(energy, u)[0], u))
    return fields, forces


@slow
def test_the_command_finds_families_of_fibres(tmp_path):
    """Of elements: at 20° and 80° within 3°, k1/μ within 10 %; a file for FEBio, and curves."""
    true, out = [Family(np.deg2rad(a), k1, 0.8) for a, k1 in ((20, 1.5), (80, 1.0))], tmp_path / "o"
    mesh = Elements(square_mesh("MeshQuad", 14, 2.6))
    edge = mesh.x @ [[0.30, 0.05], [0.0, 0.25]] + waves(SimpleNamespace(x=mesh.x), 0.3, 1)
    x, given = 0.1 * grid_places((27, 27)), edge.ravel()[mesh.edge]
    how = plane_stress_hgo(1.0, true), mesh.edge, given, x, np.linspace(0.4, 1, 4)
    table(tmp_path, x, stretched(mesh, *how)[0])
    assert command(tmp_path, out, "--fibres", "8")["material"] == "families of fibres"
    terms = dict(material_terms(wp.load(out / "material.json")))
    (mu,) = [2 * c for term, c in terms.items() if term.kind == "plane_stress"]
    fibres = sorted((np.rad2deg(t.angle), c / mu) for t, c in terms.items() if t.is_fibre)
    assert len(fibres) == 2
    for (angle, ratio), family in zip(fibres, true):
        assert angle == approx(np.rad2deg(family.angle), abs=3)
        assert ratio == approx(family.k1, rel=0.1)
    assert (out / "material.feb").read_text().count("fiber-exp-pow-uncoupled") == 2
    assert curves_of(out).shape[1] > 10


@slow
@parametrize("error", [0.0, 0.02])
def test_a_rubber_sheet_with_a_hole_pulls_as_it_should(tmp_path, error):
    """With a force a frame, or one: tension within its band and within 2 %."""
    skfem = finite_elements()
    width, radius = array([5.0, 3.6]), 0.4
    outline = mesh_outline(box(*width), [Circle(radius, size=0.12)], size=0.4)
    x, cells = (np.ascontiguousarray(one.T) for one in (outline.x, outline.cells))
    mesh = Elements(skfem.MeshTri(x, cells), skfem.ElementTriP2())
    ends = np.flatnonzero(np.abs(mesh.x[:, 0]) > width[0] / 2 - 1e-9)
    fixed = np.sort(np.concatenate([2 * ends, 2 * ends + 1]))
    pull = np.where(np.arange(2 * mesh.nodes) % 2, 0.0, mesh.x.repeat(2, axis=0)[:, 0])[fixed]
    x = 0.1 * grid_places((51, 37)) - width / 2
    x = x[np.hypot(*x.T) > radius + 0.03]
    how = make_frames.mooney_rivlin, fixed, pull, (1 - 1e-9) * x, np.linspace(0.1, 0.4, 4)
    fields, forces = stretched(mesh, *how)
    table(tmp_path, x, fields)
    right = 2 * ends[mesh.x[ends, 0] > 0]
    stresses = array([force[right].sum() / width[1] for force in forces])
    stresses *= 1 + error * array([0.3, -1.0, 0.6, 0.5])
    for number, told in enumerate((stresses, stresses[-1:])):
        command(tmp_path, out := tmp_path / f"out{number}", "--stress", *map(str, told))
        stretches, middle, low, high, *_ = curves_of(out)
        true = tension(stretches, make_frames.C1, make_frames.C2)
        assert_allclose(middle, true, rtol=0.02)
        assert ((low < true) & (true < high)).all() or (number == 1 and error)  # without scatter
    cut = x[(np.abs(x[:, 0]) > 1.2) | (np.abs(x[:, 1]) < 1.7)]  # no line whole in the middle
    (folder := tmp_path / "cut").mkdir()
    table(folder, cut, [0.1 * cut, 0.2 * cut, 0.3 * cut, 0.4 * cut])
    assert command(folder, tmp_path / "out", "--stress", "1", "--along", "y") == 2


def of_febio(text, F):
    """Energy of "HGO unconstrained" and "fiber-exp-pow" in plane strain, from FEBio's manual."""
    C, J, total = F.T @ F, det(F), 0.0
    for solid in ElementTree.fromstring(text).iter("solid"):
        p = {child.tag: float(child.text) for child in solid if child.tag != "fiber"}
        if solid.get("type") == "HGO unconstrained":
            total += p["c"] / 2 * (np.trace(C) + 1 - 3) - p["c"] * np.log(J)
            total += p["k"] / 2 * ((J**2 - 1) / 2 - np.log(J))
        else:
            theta = np.deg2rad(float(solid.find("fiber/theta").text))
            n = array([cos(theta), sin(theta)])
            x = max(n @ C @ n - 1, 0.0) ** p["beta"]
            total += p["ksi"] / (p["alpha"] * p["beta"]) * np.expm1(p["alpha"] * x)
    return total


def test_febio_has_the_learned_energy_and_words_its_numbers(tmp_path):
    F = array([[0.8, 0.0], [0.3, 1.4]])
    op = HGO.on(square(1))
    (learned,) = op.nodal_energy(op.points.x @ (F - eye(2)).T)[op.interior]
    assert of_febio(febio_material(HGO), F) == approx(float(learned), rel=1e-10)
    words = in_words(HGO)
    assert words[0] == "matrix: shear modulus 0.1426, volumetric coefficient 0.078"
    assert words[1].startswith("as the published energy: E = 0.3279, ν = 0.15")
    fibre = EnergyTerm("fibre_exponential", 0.5, 2.0)
    sheet = solid((EnergyTerm("plane_stress"), 3.5), (EnergyTerm("mooney"), 1.5), (fibre, 15.0))
    save_febio(sheet, tmp_path / "sheet.xml")
    root = ElementTree.parse(tmp_path / "sheet.xml").getroot()
    assert root.get("type") == "uncoupled solid mixture"
    assert [float(root.find(f"solid/{name}").text) for name in ("c1", "c2")] == [3.5, 1.5]
    assert in_words(sheet) == [
        "incompressible matrix: shear modulus 10 (Mooney and Rivlin: C1 = 3.5, C2 = 1.5)",
        "fibres at 28.6°: k1 = 15, k2 = 2",
    ]
