"""What `needleforce doctor` finds: the installation, the compiler, the machine.

Reading order: `distributions` (what is installed), `compiler` (its cache), `machine`
(cores, clock, real time), `findings` (all of it, as text).
"""
