"""The neural operator: what its form guarantees, its derivatives, its files."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest
import torch

import warp_peri as wp
from tests.support.nonlinear import rotation
from tests.support.problems import ell, lattice
from warp_peri.core.record import content_hash
from warp_peri.errors import InputError
from warp_peri.neural.material import CHUNK, NeuralOperator, evaluate, load, network, save
from warp_peri.neural.placed import interpolated_force, matrix
from warp_peri.points.points import Points

HORIZON = 3.0
FORMS = {
    "isotropic": {},
    "anisotropic": {"anisotropic": True},
    "proportional": {"anisotropic": True, "proportional": True},
}
ROUNDING = 1e-11
WEIGHTS = Path(__file__).parent.parent.parent / "examples" / "neural_weights"


def small(form="isotropic", **other):
    return NeuralOperator(HORIZON, (6, 8), (10, 12), **FORMS[form], **other).double()


def random_field(points, size=0.05, seed=0):
    return size * np.random.default_rng(seed).normal(size=points.x.shape)


def turn(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def slow_force(material, points, u):
    """(NO1)–(NO6) in plain NumPy, bond by bond, on a lattice without a box."""

    def net(layers, inputs):
        for n, layer in enumerate(layers):
            if n % 2 == 0:
                inputs = inputs @ layer.weight.detach().numpy().T + layer.bias.detach().numpy()
            else:
                inputs = np.maximum(inputs, 0)
        return inputs[..., 0]

    x, delta, strain = points.x, material.horizon, material.strain
    distance = np.linalg.norm(x[:, None] - x[None], axis=2)
    family = [np.flatnonzero((row > 0) & (row <= delta * (1 + 1e-6))) for row in distance]

    def bonds(i):
        xi = x[family[i]] - x[i]
        r = np.linalg.norm(xi, axis=1)
        along = xi @ rotation(np.radians(points.axis))  # directions are those of the material
        inputs = along if material.anisotropic else r[:, None]
        omega = net(material.influence, inputs / delta)
        Y = xi + u[family[i]] - u[i]
        length = np.linalg.norm(Y, axis=1)
        return r, omega, length - r, Y / length[:, None]

    def states(i):
        r, omega, e, _ = bonds(i)
        theta = (omega * e * r).sum() / (omega * r**2).sum()
        stretch = e / (strain * r)
        inputs = np.stack([omega, np.full_like(r, theta / strain), stretch, r / delta], axis=1)
        t = material.scale * net(material.state, inputs)
        return t * stretch if material.proportional else t

    out = []
    for i in np.flatnonzero(points.interior):
        mine = states(i)
        back = [states(j)[list(family[j]).index(i)] for j in family[i]]
        out.append(-(points.spacing**2) * ((mine + back)[:, None] * bonds(i)[3]).sum(axis=0))
    return np.array(out)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_force_is_the_printed_one(form, angle):
    points = lattice(ell()[:4, :4], HORIZON, angle=angle)
    u = random_field(points)
    material = small(form)
    expected = slow_force(material, points, u)
    np.testing.assert_allclose(material.on(points)(u), expected, atol=1e-12 * abs(expected).max())


@pytest.mark.parametrize("form", FORMS)
def test_momenta_are_balanced(form):
    points = lattice(4, HORIZON)
    placed, u = small(form).on(points), random_field(points)
    bonds = placed.bonds
    tension = torch.randn(1, bonds.acting, dtype=torch.float64)
    *_, M = bonds.gather(torch.tensor(u)[None], torch.zeros(len(bonds.xi)).double())
    force = bonds.scatter(M, tension)[0].numpy()
    y = points.x + u
    assert abs(force.sum(axis=0)).max() < ROUNDING
    assert abs((y[:, 0] * force[:, 1] - y[:, 1] * force[:, 0]).sum()) < 100 * ROUNDING
    x = np.argwhere(np.ones((9, 9))).astype(float)
    torus = Points(x, np.ones(81, bool), 1.0, box=(9.0, 9.0))
    total = small(form).on(torus)(random_field(torus))
    assert abs(total.sum(axis=0)).max() < ROUNDING * abs(total).max() * len(x)


@pytest.mark.parametrize("form", FORMS)
def test_any_strain_has_a_force(form):
    """Stretched tenfold, folded, all nodes at one place; a turn of that turns its force."""
    points, R = lattice(3, HORIZON), turn(2.0)
    placed, u = small(form).on(points), random_field(lattice(3, HORIZON), 0.3)
    for F in (10 * np.eye(2), np.diag([1.0, -0.5]), np.zeros((2, 2))):
        moved = points.x @ F.T + u * (F.any())
        force = placed(moved - points.x)
        assert np.isfinite(force).all()
        size = max(abs(force).max(), 1.0)
        np.testing.assert_allclose(placed(moved @ R.T - points.x), force @ R.T, atol=1e-9 * size)


def test_there_need_be_no_energy_and_no_one_solution():
    """The tangent at a field is not symmetric, nor is that at rest always definite."""
    points = lattice(3, HORIZON)
    inner = np.repeat(points.interior, 2)
    placed = small().on(points)
    J = matrix(placed.tangent(torch.tensor(random_field(points)))).toarray()[:, inner]
    assert abs(J - J.T).max() > 1e-3 * abs(J).max()
    signs = set()
    for seed in range(6):
        at_rest = small(seed=seed).on(points).tangent(torch.zeros(len(points.x), 2).double())
        eigenvalues = np.linalg.eigvals(matrix(at_rest).toarray()[:, inner]).real
        signs.add(bool(eigenvalues.min() > 0))
    assert False in signs


def test_a_finer_lattice_has_the_same_response():
    """The operator is an integral: sums over lattices differ by what enters and leaves the ball."""
    material = small()
    forces = []
    for n in (2, 4, 8):
        spacing = 1.0 / n
        points = lattice(1, HORIZON, spacing)
        x = points.x - points.x[points.interior]
        u = 0.02 * np.stack([np.sin(x[:, 0] + 0.3), np.cos(0.7 * x[:, 1] + 0.2)], axis=1)
        forces.append(material.on(points)(u)[0])
    for force in forces[:2]:
        assert np.linalg.norm(force - forces[2]) < 0.05 * np.linalg.norm(forces[2])


@pytest.mark.parametrize("form", FORMS)
def test_gradients_against_differences(form):
    points = lattice(3, HORIZON)
    material = small(form)
    placed = material.on(points)
    u = torch.tensor(np.stack([random_field(points, seed=n) for n in (0, 1)]), requires_grad=True)
    weight = torch.tensor(np.random.default_rng(2).normal(size=(2, 9, 2)))
    parts = {"u": u, **dict(material.named_parameters())}
    found = torch.autograd.grad((placed(u) * weight).sum(), list(parts.values()))
    random = torch.Generator().manual_seed(3)
    for (name, part), gradient in zip(parts.items(), found):
        step = torch.randn(part.shape, generator=random, dtype=torch.float64)
        values = []
        with torch.no_grad():
            for sign in (1, -2, 1):
                part += sign * 1e-6 * step
                values.append(float((placed(u) * weight).sum()))
        expected = (values[0] - values[1]) / 2e-6
        size = float(gradient.norm() * step.norm())
        assert abs(float((gradient * step).sum()) - expected) < 1e-6 * size, name


@pytest.mark.parametrize("form", FORMS)
def test_products_with_the_tangent(form):
    points = lattice(3, HORIZON)
    placed = small(form).on(points)
    u, v = (random_field(points, seed=n) for n in (0, 1))
    product = placed.product(u, v)
    expected = (placed(u + 1e-5 * v) - placed(u - 1e-5 * v)) / 2e-5
    np.testing.assert_allclose(product, expected, atol=1e-7 * abs(expected).max())
    tangent = placed.tangent(torch.tensor(u))
    J = matrix(tangent)
    np.testing.assert_allclose((J @ v.ravel()).reshape(-1, 2), product, atol=ROUNDING)
    w = np.random.default_rng(4).normal(size=product.shape)
    back = tangent.transposed(torch.tensor(w)).numpy()
    np.testing.assert_allclose(back.ravel(), J.T @ w.ravel(), atol=ROUNDING)


def test_many_bonds_at_once_are_the_plain_network():
    torch.manual_seed(0)
    layers = network(4, 32, 48, 1).double()
    x = 0.2 * torch.randn(CHUNK + 100, 4, dtype=torch.float64) + torch.tensor([1.0, 0, 0, 0.5])
    x.requires_grad_()
    seed = torch.randn(len(x), dtype=torch.float64)
    wanted = [x, *layers.parameters()]
    plain = torch.autograd.grad(layers(x)[:, 0] @ seed, wanted)
    value = evaluate(layers, x)
    torch.testing.assert_close(value, layers(x)[:, 0], rtol=0, atol=1e-13)
    for found, expected in zip(torch.autograd.grad(value @ seed, wanted), plain):
        torch.testing.assert_close(
            found, expected, rtol=0, atol=1e-12 * float(expected.abs().max())
        )


@pytest.mark.parametrize("form", FORMS)
def test_interpolation_approaches_the_networks(form):
    """Rectifiers bend where they like: a cell with a kink is wrong by its width, others not."""
    points = lattice(3, HORIZON)
    placed = small(form).on(points)
    u = torch.tensor(random_field(points, 0.02))[None]
    with torch.no_grad():
        exact = placed(u)
        gaps = [float((interpolated_force(placed, u, cells=n) - exact).norm()) for n in (4, 64)]
    assert gaps[1] < gaps[0] / 16
    assert gaps[1] < 2e-3 * float(exact.norm())


def test_gradients_of_the_interpolation_against_differences():
    points = lattice(2, HORIZON)
    material = small("anisotropic")
    placed = material.on(points)
    u = torch.tensor(random_field(points))[None]
    weight = torch.tensor(np.random.default_rng(2).normal(size=(1, 4, 2)))
    size = 3.0  # a grid that moves with its own values would not be seen by the gradient

    def value():
        return (interpolated_force(placed, size * u / 3.0, cells=6) * weight).sum()

    for part in material.state.parameters():
        (gradient,) = torch.autograd.grad(value(), part)
        step = torch.randn(part.shape, generator=torch.Generator().manual_seed(5)).double()
        values = []
        with torch.no_grad():
            for sign in (1, -2, 1):
                part += sign * 1e-6 * step
                values.append(float(value()))
        expected = (values[0] - values[1]) / 2e-6
        scale = float(gradient.norm() * step.norm())
        assert abs(float((gradient * step).sum().detach()) - expected) < 1e-6 * scale


def test_a_field_of_single_precision_is_as_one_of_double():
    points = lattice(2, HORIZON)
    rough = small("anisotropic").float().on(points)
    u = torch.tensor(random_field(points))
    assert torch.equal(rough(u), rough(u.float()).double())


@pytest.mark.parametrize("precision", [None, "float32", "float16"])
def test_a_file_holds_everything(tmp_path, precision):
    material = small("proportional", strain=0.3, units=("mm", "MPa"))
    material.scale, material.provenance = 2.5, {"seed": 7}
    save(material, tmp_path / "m.json", precision=precision)
    found = load(tmp_path / "m.json")
    assert found.content() == material.content()
    allowed = {None: 0, "float32": 1e-7, "float16": 1e-3}[precision]
    for mine, theirs in zip(material.parameters(), found.parameters()):
        torch.testing.assert_close(theirs, mine, rtol=allowed, atol=allowed)
    assert load(tmp_path / "m.json", units=("m", "Pa")).horizon == pytest.approx(0.003)


def test_a_file_touches_nothing_beside_it(tmp_path):
    points = lattice(3, HORIZON)
    u = random_field(points)[None]
    wp.save(tmp_path / "m.h5", wp.Dataset({"a": wp.Samples(points, u, 0 * u)}, 3.35, 2200.0))
    wp.save(tmp_path / "m.json", small())
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["m.h5", "m.json"]
    np.testing.assert_array_equal(wp.load(tmp_path / "m.h5")["a"].u, u)
    assert wp.load(tmp_path / "m.json").numbers() == small().numbers()


def test_files_that_are_not_believed(tmp_path):
    path = tmp_path / "m.json"
    save(small(), path)
    content = json.loads(path.read_text())
    weights = content["weights"]
    first = weights["state.0.weight"]
    kept = ("A" if first[0] != "A" else "B") + first[1:]
    wrong = {
        "not what was written": {"weights": weights | {"state.0.weight": kept}},
        "reshape": hashed(content | {"state": [10, 13]}),
        "base64-encoded": hashed(content | {"weights": weights | {"state.0.weight": first[:-3]}}),
        "KeyError": hashed(content | {"weights": {}}),
        "precision|tuple": hashed(content | {"precision": "object"}),
        "version: expected 2, got 3": {"version": 3},
        "format": {"format": "x"},
    }
    for words, change in wrong.items():
        path.write_text(json.dumps(content | change))
        with pytest.raises(InputError, match=words):
            load(path)
    spoilt = small()
    with torch.no_grad():
        spoilt.state[0].weight[0, 0] = torch.nan
    with pytest.raises(InputError, match="finite"):
        save(spoilt, path)
    nan = base64.b64encode(np.full(small().state[0].weight.shape, np.nan).tobytes()).decode()
    path.write_text(json.dumps(hashed(content | {"weights": weights | {"state.0.weight": nan}})))
    with pytest.raises(InputError, match="finite"):
        load(path)
    with pytest.raises(InputError, match="json"):
        save(small(), tmp_path / "m.h5")
    wide = NeuralOperator(3.0, (4, 4), (2600, 2600)).double()
    with pytest.raises(InputError, match="at most .* bytes of weights"):
        save(wide, path)
    save(wide, path, precision="float32")
    assert load(path).numbers() == wide.numbers()


def hashed(content):
    return content | {"sha256": content_hash(content)}


@pytest.mark.parametrize("name", sorted(path.stem for path in WEIGHTS.glob("*.json")))
def test_shipped_networks_are_read_and_of_one_version(name, tmp_path):
    path = WEIGHTS / f"{name}.json"
    save(load(path), tmp_path / "m.json", precision="float16")
    content = json.loads(path.read_text())
    assert json.loads((tmp_path / "m.json").read_text()) == content
    content.pop("sha256")
    (tmp_path / "old.json").write_text(json.dumps(content | {"version": 1, "weights": "m.h5"}))
    with pytest.raises(InputError, match="version: expected 2, got 1"):
        load(tmp_path / "old.json")


def test_what_a_material_says_of_itself():
    text = repr(small("proportional", units=("mm", "MPa")))
    assert "3 mm, in mm and MPa" in text
    assert "ω(ξ), force state in proportion to e" in text
    assert str(small().numbers()) in repr(small())
    assert "<table>" in small()._repr_html_()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"horizon": 0.0}, "horizon"),
        ({"strain": np.nan}, "strain"),
        ({"influence": (3,)}, "influence"),
        ({"state": (3, 0)}, "state"),
        ({"state": 3}, "state"),
        ({"horizon": "wide"}, "horizon"),
        ({"units": ("mile", "Pa")}, "length_unit"),
    ],
)
def test_numbers_that_are_refused(given, words):
    with pytest.raises(InputError, match=words):
        NeuralOperator(**{"horizon": HORIZON, **given})


def test_points_and_fields_that_are_refused():
    points = lattice(3, HORIZON)
    placed = small().on(points)
    u = random_field(points)
    for field in (np.zeros((4, 2)), u[None, :4]):
        with pytest.raises(InputError, match="shape"):
            placed(field)
        with pytest.raises(InputError, match="v: expected shape"):
            placed.product(u, field)
    with pytest.raises(InputError, match="at least one sample"):
        placed(u[None][:0])
    with pytest.raises(InputError, match="v: expected torch.float64"):
        placed.product(torch.tensor(u), torch.tensor(u).float())
    with pytest.raises(InputError, match="u: expected shape"):
        placed.product(u[None], u)
    scattered = Points(points.x, points.interior, 0.0)
    with pytest.raises(InputError, match="lattice"):
        small().on(scattered)
    with pytest.raises(InputError, match="a linear material for a Body"):
        wp.solve(small(), wp.Body(None, {}))
    cube = Points(np.argwhere(np.ones((3, 3, 3))).astype(float), np.ones(27, bool), 1.0)
    with pytest.raises(InputError, match="expected a plane, got 3 dimensions"):
        small().on(cube)
    with pytest.raises(InputError, match="complete families"):
        small().on(Points(points.x, np.ones(len(points.x), bool), 1.0))
