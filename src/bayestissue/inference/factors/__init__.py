"""One factor per impact, its trace's likelihood: expanded at a maximum, or nearest to visited points."""
