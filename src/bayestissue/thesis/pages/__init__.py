"""The pages of `reproduce` and of `causes`."""
