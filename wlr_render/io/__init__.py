"""Files: bounded reading of untrusted files, TOML and JSON tables, text tables, atomic writing, ledgers."""
