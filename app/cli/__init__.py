"""The command `liftwright`, one file a subcommand that does more than start something."""
