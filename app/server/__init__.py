"""How the service listens: who is let in at the wire, how many, and for how long."""
