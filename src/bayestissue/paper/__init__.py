"""What a paper takes from a finished fit: methods and results as text, tables as a workbook, figures."""
