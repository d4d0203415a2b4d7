"""The demonstrations that `needleforce demo` runs: what they print, and their page."""
