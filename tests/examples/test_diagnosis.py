"""Sheets of atoms, and the cause that the diagnosis names."""

import pytest

from examples.studies.diagnosis import SHEETS, study


@pytest.mark.slow
@pytest.mark.parametrize("sheet", [s for s in SHEETS if s.name in ("stretched", "sheared")])
def test_a_stretched_sheet_is_called_anisotropic(sheet):
    (row,) = study([sheet])
    assert row["named"] == ["anisotropy"]
    assert row["shares"]["anisotropy"] > 0.8
    assert row["shares"]["heterogeneity"] < 0.1
