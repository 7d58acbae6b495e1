"""A law of a file of before: what it says, and how it flows."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import warp_peri as wp
from examples.polymer import FENEP, Giesekus, PlaneFlow, homogeneous, load, shear
from examples.polymer.learned import OutsideWarning

FILE = Path(__file__).with_name("flow.json")


def test_a_law_of_a_file_says_what_it_said():
    law, C, K = load(FILE), np.array([[1.3, 0.2, 0.2, 0.9]]), np.array([[0, 0.5, 0, 0]])
    stress = [0.540921099907639, 0.23631858893425237, -0.758831139230749, 0.016431997068202087]
    rate = [-0.3409210999076391, -0.13631858893425236, 0.758831139230749, -0.016431997068202087]
    np.testing.assert_allclose(law.stress(C)[0], stress, rtol=1e-12)
    np.testing.assert_allclose(law.rate(K, C)[0], rate, rtol=1e-12)


@pytest.mark.parametrize(
    ("law", "norm", "largest"),
    [
        (load(FILE), 5.976050474180641, 0.47402737097689174),
        (FENEP(50.0), 5.962847117245279, 0.47277560872420915),
        (Giesekus(0.2), 5.957136807718438, 0.4724514437799957),
    ],
)
def test_a_plane_flow_is_what_it_was(law, norm, largest):
    channel = PlaneFlow(De=1.0, Re=1.0, cells=16, force=lambda t: 1.0)
    u = wp.move(law, channel, until=0.5, dt=0.01)["u"]
    np.testing.assert_allclose([np.linalg.norm(u), np.abs(u).max()], [norm, largest], rtol=1e-10)


def test_a_run_says_once_that_it_left_the_data():
    fast = shear(np.full((30, 1), 30.0))
    with pytest.warns(OutsideWarning) as found:
        homogeneous(load(FILE), fast, 0.1)
    assert len([one for one in found if one.category is OutsideWarning]) == 1
    flow = PlaneFlow(De=1.0, Re=1.0, cells=8, force=lambda t: 300.0)
    with pytest.warns(OutsideWarning) as again:
        wp.move(load(FILE), flow, until=0.3, dt=0.005)
    assert len([one for one in again if one.category is OutsideWarning]) == 1


def test_the_library_alone_refuses_a_law_of_flow():
    code = f"import warp_peri as wp; wp.load({str(FILE)!r})"
    job = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "warp_peri.flow_law: left the library; commit" in job.stderr
