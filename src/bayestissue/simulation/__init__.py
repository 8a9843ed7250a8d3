"""Campaigns whose truth is known: a design, a tissue and a measuring chain, from a specification."""
