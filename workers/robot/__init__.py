"""Programs on real controllers: a link to each arm, and what watches both while they run a plan."""
