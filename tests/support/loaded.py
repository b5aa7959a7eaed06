"""What keeps `liftwright` from being ready at once, done when this is imported: by the process that forks."""

from importlib import import_module

from planners.cell.cell import load_cells

for module in ("app.cli.main", "app.serve", "app.create_app", "workers.engine.worker", "workers.solver.warm_up"):
    import_module(module)
# The first kernel that is run has the compiler get ready.
load_cells()
