"""Learning: errors fall, work that was stopped goes on, and what cannot be learned is refused."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.support.problems import lattice
from warp_peri.errors import InputError
from warp_peri.neural import training
from warp_peri.neural.material import NeuralOperator
from warp_peri.neural.placed import NeuralEquilibrium, evaluate
from warp_peri.neural.training import Training, residuals, train
from warp_peri.points.samples import Samples

HORIZON = 2.5


def waves(points, seed, count):
    random = np.random.default_rng(seed)
    k, phase = random.uniform(-1, 1, (count, 2, 2)), random.uniform(0, 6, (count, 2))
    return 0.03 * np.sin(points.x @ k.transpose(0, 2, 1) + phase[:, None])


def truth():
    """A material to learn: its force state pulls back, and hardens."""
    material = NeuralOperator(HORIZON, (6, 8), (10, 12), proportional=True, seed=5)
    return material.double()


def loads(seed, count=6):
    points = lattice(4, HORIZON)
    u, placed = waves(points, seed, count), truth().on(points)
    b = np.zeros_like(u)
    b[:, points.interior] = placed(u)
    return Samples(points, u, b)


def frames(seed, count=3):
    points = lattice(3, HORIZON)
    search, fields = NeuralEquilibrium(truth().on(points)), waves(points, seed, count)
    u = [search.solve(np.zeros_like(field), field).u for field in fields]
    return Samples(points, np.array(u))


def student(**other):
    return NeuralOperator(HORIZON, (8, 8), (16, 16), strain=0.2, seed=1, **other).double()


@pytest.mark.parametrize("cells", [12])
def test_forces_are_learned(cells):
    material = student()
    settings = Training(epochs=60, rate=1e-2, batch=2, cells=cells)
    history = train(material, loads(0), loads(1), settings, progress=False)
    assert history.epochs == 60
    assert history.best > 20
    assert history.curve[-1][1] < 0.2 * history.curve[0][1]
    unseen = loads(2)
    errors = evaluate(material, unseen)
    assert errors["E_res"] == pytest.approx(residuals(material, unseen).mean())
    assert errors["E_res"] < 0.25
    assert errors["E_u"] < 0.15
    assert errors["converged"] == 1


def test_displacements_are_learned():
    material = student(proportional=True)
    before = residuals(material, frames(4)).mean()
    settings = Training(epochs=20, rate=1e-2, batch=3)
    history = train(material, frames(3), frames(4), settings, progress=False)
    assert history.curve[-1][2] < 0.5 * before
    assert residuals(material, frames(5)).mean() < 0.6 * before


@pytest.mark.parametrize("seen", [loads, frames])
def test_a_stopped_training_goes_on_where_it_was(tmp_path, seen):
    samples, val = seen(0), seen(1)
    settings = Training(epochs=10, rate=1e-3, batch=2)
    whole, parts = (student(proportional=seen is frames) for _ in range(2))
    train(whole, samples, val, settings, progress=False)
    path = tmp_path / "run.ckpt"
    part = train(parts, samples, val, settings, checkpoint=path, seconds=0.0, progress=False)
    assert part.epochs == 1
    fresh = student(proportional=seen is frames)
    history = train(fresh, samples, val, settings, checkpoint=path, progress=False)
    assert history.epochs == 10
    for mine, theirs in zip(whole.parameters(), fresh.parameters()):
        gap = 0 if seen is loads else 1e-7  # starts and factors of a search are not kept
        torch.testing.assert_close(mine, theirs, rtol=0, atol=gap)


def test_an_interrupted_training_goes_on_from_its_last_epoch(tmp_path, monkeypatch):
    samples, val, settings = loads(0), loads(1), Training(epochs=9, batch=2)
    whole, parts, path = student(), student(), tmp_path / "run.ckpt"
    train(whole, samples, val, settings, progress=False)
    monkeypatch.setattr(training, "SAVED", 0.0)
    with monkeypatch.context() as patched:
        epoch = training._Run.epoch

        def stops(run):
            if run.history.epochs == 3:  # before the first look
                raise KeyboardInterrupt
            return epoch(run)

        patched.setattr(training._Run, "epoch", stops)
        with pytest.raises(KeyboardInterrupt):
            train(parts, samples, val, settings, checkpoint=path, progress=False)
    assert torch.load(path, weights_only=True)["history"]["epochs"] == 3
    fresh = student()
    train(fresh, samples, val, settings, checkpoint=path, progress=False)
    for mine, theirs in zip(whole.parameters(), fresh.parameters()):
        assert torch.equal(mine, theirs)


def test_checkpoints_of_other_trainings(tmp_path):
    path = tmp_path / "run.ckpt"
    settings = Training(epochs=1, batch=2)
    train(student(), loads(0), loads(1), settings, checkpoint=path, progress=False)

    def goes_on(material, samples, training=settings):
        train(material, samples, loads(1), training, checkpoint=path, progress=False)

    with pytest.raises(InputError, match="batch"):
        goes_on(student(), loads(0), Training(epochs=2, batch=3))
    with pytest.raises(InputError, match=r"influence \[8, 8\], expected \[8, 9\]"):
        goes_on(NeuralOperator(HORIZON, (8, 9), (16, 16), strain=0.2).double(), loads(0))
    with pytest.raises(InputError, match="the checkpoint has samples"):
        goes_on(student(), loads(3))
    moved = loads(0)
    moved = replace(moved, points=replace(moved.points, x=moved.x + 1.0))
    with pytest.raises(InputError, match="the checkpoint has samples"):
        goes_on(student(), moved)
    with pytest.raises(InputError, match="the checkpoint has validation"):
        train(student(), loads(0), loads(2), settings, checkpoint=path, progress=False)
    with pytest.raises(InputError, match="the checkpoint has precision"):
        goes_on(student().float(), loads(0))
    scaled = student()
    scaled.scale *= 2
    for other in (scaled, NeuralOperator(HORIZON, (8, 8), (16, 16), strain=0.2, seed=7).double()):
        with pytest.raises(InputError, match="the checkpoint has first numbers"):
            goes_on(other, loads(0))
    state = torch.load(path, weights_only=True)
    state["kept"] = {name: 5 * part for name, part in state["kept"].items()}
    torch.save(state, tmp_path / "changed.ckpt")
    changed = tmp_path / "changed.ckpt"
    with pytest.raises(InputError, match="the contents are not what was written"):
        train(student(), loads(0), loads(1), settings, checkpoint=changed, progress=False)
    whole = path.read_bytes()
    for content in (b"no checkpoint", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(InputError, match="expected a checkpoint"):
            goes_on(student(), loads(0))
    for state in ({"a": 1}, [1, 2]):
        torch.save(state, path)
        with pytest.raises(InputError, match="expected a checkpoint"):
            goes_on(student(), loads(0))


def test_a_training_that_diverges_is_told():
    settings = Training(epochs=2, rate=1e200, cells=0)
    with pytest.raises(InputError, match="no look found a finite error"):
        train(student(), loads(0), loads(1), settings, progress=False)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"epochs": 0}, "epochs"),
        ({"epochs": np.nan}, "epochs"),
        ({"batch": 1.5}, "batch"),
        ({"rate": -1.0}, "rate"),
        ({"rate": "fast"}, "rate"),
        ({"seed": "a"}, "seed"),
    ],
)
def test_settings_that_are_refused(given, words):
    with pytest.raises(InputError, match=words):
        Training(**given)


def test_samples_that_nothing_is_learned_from():
    """Without them, or with a norm of zero below the line, there would be no error to lower."""
    one, unseen, bare = loads(0), loads(1), loads(0)
    one.b[1] = 0
    none = Samples(unseen.points, unseen.u[:0], unseen.b[:0])
    at_rest = Samples(bare.points, 0 * bare.u)
    bare = Samples(bare.points, bare.u)
    for samples, val, words in (
        (one, unseen, "expected a load in every sample"),
        (none, unseen, "expected at least one, got none"),
        (unseen, none, "expected at least one, got none"),
        (unseen, bare, "validation: expected loads"),
        (bare, unseen, "validation: expected no loads"),
        (at_rest, at_rest, "expected every frame displaced"),
    ):
        with pytest.raises(InputError, match=words):
            train(student(), samples, val, Training(epochs=1), progress=False)
    with pytest.raises(InputError, match="training: expected"):
        student().learn(unseen, validation=unseen, training=150)
    with pytest.raises(InputError, match="samples: expected Samples, got list"):
        student().learn([unseen], validation=unseen)
