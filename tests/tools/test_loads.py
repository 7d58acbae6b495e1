"""The 84 loads of You et al. 2021, section 6.1."""

import numpy as np
import pytest

from tools.graphene import disk, sheet
from tools.loads import TEST, TRAINING, UNLOADED_RADIUS, VALIDATION, RimLoad, WaveLoad

POSITIONS, BOX = sheet(1.46)
DISK = disk(1.46)


def test_numbers_and_order():
    assert [len(TRAINING), len(VALIDATION), len(TEST)] == [70, 10, 4]
    assert [load.load_id for load in (TRAINING[0], TRAINING[5], TRAINING[69])] == [
        "x k=(0,1)",
        "x k=(1,0)",
        "y k=(5,5)",
    ]
    assert len({load.load_id for load in [*TRAINING, *VALIDATION, *TEST]}) == 84


@pytest.mark.parametrize("load", [*TRAINING, *VALIDATION, *TEST], ids=lambda load: load.load_id)
def test_self_equilibrated(load):
    """No net force on the body, and none to turn the free disk."""
    x = DISK if isinstance(load, RimLoad) else POSITIONS
    shape = load.shape(x, BOX)
    scale = np.abs(shape).sum()
    assert scale > 1
    assert np.abs(shape.sum(axis=0)).max() < 1e-12 * scale
    if isinstance(load, RimLoad):
        turn = x[:, 0] * shape[:, 1] - x[:, 1] * shape[:, 0]
        assert abs(turn.sum()) < 1e-12 * scale * np.abs(x).max()


@pytest.mark.parametrize("load", [*TRAINING, *VALIDATION], ids=lambda load: load.load_id)
def test_periodic(load):
    """Atoms moved by a period, as LAMMPS may hold them, carry the same wave; patches stay round."""
    shape = load.shape(POSITIONS, BOX)
    if isinstance(load, WaveLoad):
        assert np.allclose(load.shape(POSITIONS + BOX, BOX), shape, atol=1e-12)
    else:
        # Across the edge of the sheet: atoms just inside +L/2 and just inside −L/2.
        edge, half = load.edge, BOX[load.edge] / 2
        for side in (1, -1):
            near = np.abs(POSITIONS[:, edge] - side * half) < 2.0
            middle = np.abs(POSITIONS[:, 1 - edge]) < 2.0
            assert (shape[near & middle, load.axis] < -0.9).all()
        centre = np.linalg.norm(POSITIONS, axis=1) < 1.5
        assert (shape[centre, load.axis] > 0.9).all()


def test_wave_number_belongs_to_the_true_box():
    load = WaveLoad(1, (3, 4))
    assert np.hypot(*load.wave_vector((20.0, 20.0))) == pytest.approx(2 * np.pi * 5 / 20)
    with pytest.raises(ValueError, match="periods"):
        load.wave_vector(None)


def test_disk_is_unloaded_inside_and_as_printed_outside():
    r, t = np.linalg.norm(DISK, axis=1), np.arctan2(DISK[:, 1], DISK[:, 0])
    for load in TEST:
        assert np.abs(load.shape(DISK)[r <= UNLOADED_RADIUS]).max() == 0
    out = r > UNLOADED_RADIUS
    four = TEST[3].shape(DISK)[out]
    assert np.allclose(four[:, 0], np.sin(3 * t[out]) * np.sin(t[out]), atol=1e-12)
    assert np.allclose(four[:, 1], np.sin(3 * t[out]) * np.cos(t[out]), atol=1e-12)
    three = TEST[2].shape(DISK)[out]
    assert np.abs(three[:, 0]).max() == 0
    assert np.allclose(three[:, 1] + (2 / np.pi), np.abs(np.sin(t[out])), atol=2e-3)
