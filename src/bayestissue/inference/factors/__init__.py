"""One factor per impact, its trace's likelihood: Laplace, moments, regression, a grid, importance ratios."""
