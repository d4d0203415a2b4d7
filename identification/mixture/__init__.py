"""A Gaussian mixture over what may have ruptured, and where: the default method.

Given a history of contacts and ruptures the axial force is linear in twenty unknowns:
a Kalman filter estimates them. Each history is a component of the mixture, its weight
how well it predicts the force.

Reading order: `force_model` (the unknowns of one hypothesis), `priors`, `events` (what
a contact or a rupture does to them), `mixture` (predict, correct, branch, prune);
`learner` (what it learns from a block of force); `evidence` (alarms),
`reporter` (alarms and layers, raised, retracted, revised), `layer_report`;
`needle_contact` (the block being filled), `shaft_posterior`, `force_split` (tip force
of every sample); `method` (what happens when). Beside them: `block`, `kalman`,
`disturbances`, `noise_levels`, `speed_filter`, `needle_stop`, `needle_swing` (tremor);
tissue that moves by itself: `tissue_motion`, `motion_fit`; forces that
are no such tissue's, or in doubt, `force_watch`: `foreign_force`, `tissue_doubt`.
"""
