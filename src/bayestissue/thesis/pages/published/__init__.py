"""The report of the re-analysis of the published estimates."""
