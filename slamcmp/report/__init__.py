"""Figures, tables and the HTML report."""

from slamcmp.report.figures.draw import FigureFiles, draw_figures
from slamcmp.report.html import write_report
from slamcmp.results.judgements.summary import summary_table

__all__ = ["draw_figures", "FigureFiles", "write_report", "summary_table"]
