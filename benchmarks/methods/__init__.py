"""The methods that are compared, each run over a whole signal, and what they told.

Reading order: `force_reading` (an axial force as told), `ft_force` and `virtual_force` (who tells
it) with `sensor_settings`; `identified` (an identifier's run) with `alarm`; `offline_fit` and
`joint_residual` for comparison.
"""
