"""Impacts each by itself: the posterior of one trace under weak priors, and the table of `estimate`."""
