"""Problems that everybody knows, posed to every material that can take them."""

from warp_peri.verification.rows import ROWS, by_material, chosen, measured, page, table, verified

__all__ = ["ROWS", "by_material", "chosen", "measured", "page", "table", "verified"]
