"""The editor: a task that may be unfinished, drawn and dragged in a scene of the viewer."""
