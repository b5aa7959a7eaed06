"""The balance program (5) of paper B: least-effort wrenches that hold the plate, or a proof that there are none."""
