"""Stress, strain and energy at nodes: what users call warp_peri.stress."""

from warp_peri.operator.stress import NodeFields, node_fields

__all__ = ["NodeFields", "node_fields"]
