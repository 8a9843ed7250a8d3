"""What a paper takes from a finished fit: methods and results as text, tables as a workbook, figures."""

# Of a figure in print: a journal's column.
WIDTH_MM = 85.0
