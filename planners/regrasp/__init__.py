"""Paper A: a dual-arm robot regrasps a suction tool and moves objects with it."""
