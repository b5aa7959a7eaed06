"""Contact states of the plate with its support (paper B, IV-A)."""
