"""The plan of a task as one value: what moves when, how it is held, what was checked, and what physics made of it."""
