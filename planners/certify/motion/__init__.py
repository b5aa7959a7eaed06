"""Where robots and bodies are at every moment, and whether they hit one another."""
