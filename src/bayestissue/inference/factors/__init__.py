"""One factor per impact, its trace's likelihood: Laplace, regression, a grid, importance ratios."""
