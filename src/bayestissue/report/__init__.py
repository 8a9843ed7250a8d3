"""Tables, figures and pages for people."""

from bayestissue.report.run_folder import draw_page, write_report

__all__ = ["draw_page", "write_report"]
