"""Grasps of the tool: where two pads meet it, which an arm can reach, and which pairs of them pass it on."""
