"""Problems that everybody knows, posed to every material that can take them."""

from warp_peri.verification.rows import ROWS as ROWS
from warp_peri.verification.rows import by_material, chosen, measured, page, table, verified

__all__ = ["by_material", "chosen", "measured", "page", "table", "verified"]
