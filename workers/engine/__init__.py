"""A worker at work: takes jobs, has them solved, takes over those of dead workers, and keeps the house."""
