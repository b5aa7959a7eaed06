"""A plan executed in physics: a plate's, with the cooperative lift that follows it, or a suction tool's.

`simulate` is where it begins and ends. Both kinds share `bullet` and `world` (the cell, and what moves freely in it),
`timeline` (what the plan wants when), `recording` (what is kept) and `settings` (what is assumed).

In a lift `lift_execution` has `hands`, with their `touch`, follow the `lift_reference` under the `lifter`, and then the
`cooperative_lift`. With a suction tool `tool_execution` takes and lets go by `holds`: fingers and a cup that can fail.
"""
