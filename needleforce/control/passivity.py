"""Passivity in the time domain: energy through a port is observed, and what may leave
is limited.

A port carries a force f that resists a motion x. With a force held between the samples
its energy is known exactly, whatever moves it:

    ΔE_k = f_{k-1} (x_k - x_{k-1})          > 0 enters the network, < 0 leaves it

A network of two ports with delayed packets between them is passive if at each of them
no more leaves than entered, some time before, at the other:

    out_M(t) ≤ in_S(t - T) + allowance,     out_S(t) ≤ in_M(t - T) + allowance

(Ryu, Kwon & Hannaford 2004; Artigas, Ryu & Preusche 2010.) The port of a hand also
keeps ``out_M ≤ in_M``: whatever happens elsewhere, a hand never gets more energy than
it has put in.
"""

import math

HANDLE_kg = 0.25
MOST_DAMPING_Ns_m = 150.0
"""Mass of the device's handle as a hand feels it, and largest damping shown at it."""
HAND_J = 1e-3
HAND_W = 2e-3
"""What the hand may get early: one that yields to a spring need not wait for the
news of it."""
FORCE_LAG_s = 0.015  # Of the virtual sensor's force, see `InsertionSession.lag_s`


class Port:
    """Energy through one port since it was made: `in_J` has entered the network,
    `out_J` left it.

    Args:
        allowance_J: What may leave beyond what has entered at the other side: force and
            motion that meet with a delay never balance exactly.
        allowance_W: The same, per second; hand and tissue dissipate as much in any
            case.
    """

    def __init__(self, allowance_J: float = 0.0, allowance_W: float = 0.0) -> None:
        self._allowance_J = allowance_J
        self._allowance_W = allowance_W
        self._allowed_J = allowance_J
        self.in_J = self.out_J = 0.0

    @property
    def net_J(self) -> float:
        """What the network has kept of it; below zero it has given more than it got."""
        return self.in_J - self.out_J

    def observe(self, force_N: float, travel_m: float) -> None:
        """Count one interval: the force held over it, and the travel against that
        force.
        """
        energy_J = force_N * travel_m
        self.in_J += max(energy_J, 0.0)
        self.out_J -= min(energy_J, 0.0)

    def budget_J(self, incoming_J: float, dt_s: float) -> float:
        """What may still leave when a further time has passed, see the module.

        Unused allowance does not grow: after a quiet insertion it would feed seconds of
        swinging.
        """
        owed_J = self.out_J - incoming_J
        most_J = self._allowance_J + max(owed_J, 0.0)
        self._allowed_J = min(self._allowed_J + self._allowance_W * dt_s, most_J)
        return self._allowed_J - owed_J


def passive_part(leaving_J: float, budget_J: float) -> float:
    """The fraction, 0 to 1, of a force or a speed with which no more leaves than the
    budget.

    Below zero are what would leave where energy enters, the budget where too much has
    left.
    """
    return 1.0 if leaving_J <= max(budget_J, 0.0) else max(budget_J, 0.0) / leaving_J


class HandPort(Port):
    """Observer and controller at the port where a device shows a force to a hand.

    The force is first cut to what may leave in the coming interval. What the hand has
    not put in is cut as if the device were free: the force f pushes a mass m through v
    Δt - f Δt² / 2m, and

        -f (v Δt - f Δt² / 2m) ≤ E     <=>     f ≤ (m / Δt) (v + √(v² + 2E / m))

    A hand that pushes the same way may still take a little more; damping then takes it
    back. Cutting comes first, since a damper needs speed and a sampled device cannot
    show much damping.
    """

    def __init__(self) -> None:
        super().__init__(HAND_J, HAND_W)
        self._force_N = self._damping_N = self._damped_J = self._position_m = 0.0

    def update(
        self,
        wanted_N: float,
        position_m: float,
        speed_m_s: float,
        incoming_J: float,
        times_s: tuple[float, float],
    ) -> float:
        """The force to hold over the coming interval, positive against positive motion.

        Given are what should be shown, the handle's place and rate, what is known to
        have entered at the other side, and the times since the last call and, at most,
        until the next.
        """
        dt_s, ahead_s = times_s
        travel_m = (
            position_m - self._position_m
        )  # means nothing at first, when no force is held
        self.observe(self._force_N, travel_m)
        # What damping has taken is paid back; not to count it would damp for ever
        # after.
        self._damped_J += self._damping_N * travel_m
        owed_J = self.budget_J(incoming_J, dt_s) + self._damped_J
        force_N = wanted_N * passive_part(-wanted_N * speed_m_s * ahead_s, owed_J)
        against_m_s = math.copysign(speed_m_s, wanted_N * speed_m_s)
        root_m_s = math.sqrt(
            speed_m_s * speed_m_s + 2.0 * max(self.net_J, 0.0) / HANDLE_kg
        )
        most_N = HANDLE_kg / ahead_s * (against_m_s + root_m_s)
        force_N = math.copysign(min(abs(force_N), most_N), force_N)
        missing_J = -min(owed_J, self.net_J)
        self._damping_N = 0.0
        if missing_J > 0.0:
            # More than m / Δt, held over an interval, would turn the handle round.
            most_Ns_m = min(MOST_DAMPING_Ns_m, HANDLE_kg / ahead_s)
            most_J = most_Ns_m * speed_m_s * speed_m_s * ahead_s
            damping_N = passive_part(most_J, missing_J) * most_Ns_m * speed_m_s
            self._damping_N = min(max(damping_N, -most_N - force_N), most_N - force_N)
        self._force_N = force_N + self._damping_N
        self._position_m = position_m
        return self._force_N

    def release(self, travel_m: float) -> None:
        """No force is held any more, after about so much travel, which is not
        believed to give.
        """
        self.observe(min(self._force_N * travel_m, 0.0), 1.0)
        self._force_N = self._damping_N = 0.0


class NeedlePort(Port):
    """Observer and controller at the port where a robot moves a needle against a force.

    The force is known only late, so the speed is delayed as much before both are
    multiplied: else a needle that bounces off a wall, the force still high while it
    retreats, seems to bring energy. A delayed force is shown too low while it rises, so
    the hand always owes some: the allowance.
    """

    _lagged_m_s = 0.0

    def update(
        self,
        wanted_m_s: float,
        force_N: float,
        speed_m_s: float,
        incoming_J: float,
        dt_s: float,
    ) -> float:
        """The speed to move with over the coming interval, positive into the tissue.

        Given are the wanted one, the force against it, the speed now and what has
        entered at the other side, as far as known here.
        """
        self._lagged_m_s += (speed_m_s - self._lagged_m_s) * dt_s / (FORCE_LAG_s + dt_s)
        self.observe(-force_N, self._lagged_m_s * dt_s)
        budget_J = self.budget_J(incoming_J, dt_s)
        return wanted_m_s * passive_part(force_N * wanted_m_s * dt_s, budget_J)
