"""The published results: recomputed, audited, compared."""
