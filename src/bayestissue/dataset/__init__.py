"""What a lab brings in: folder layout, recorder formats, units, validation, and the published tables."""
