"""The peridynamic neural operator: influence and scalar force state as networks."""
