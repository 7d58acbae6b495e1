"""Problems that everybody knows, posed to every material that can take them."""

from warp_peri.verification.rows import ROWS as ROWS
from warp_peri.verification.rows import (
    as_csv,
    by_atoms,
    by_material,
    chosen,
    measured,
    page,
    table,
    verified,
)

__all__ = ["as_csv", "by_atoms", "by_material", "chosen", "measured", "page", "table", "verified"]
