"""The same posterior for many impacts, at a cost that many impacts allow."""
