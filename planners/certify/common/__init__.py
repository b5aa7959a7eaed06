"""Laws that every plan obeys, whatever its kind."""
