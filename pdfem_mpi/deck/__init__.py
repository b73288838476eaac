"""What to simulate: tables, checks, TOML, sentences."""
