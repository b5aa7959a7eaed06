"""Who may do what: keys, sessions of browsers, limits, and the log of who did what."""
