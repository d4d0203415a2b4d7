"""The commands: `needleforce` and what its sub-commands share."""
