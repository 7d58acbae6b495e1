"""An answer with its error: the richest model is evaluated, and corrects (theory.md, Q1–Q9)."""
