"""Figures as specifications of Vega-Lite, from tables: for pages, notebooks and files alike."""
