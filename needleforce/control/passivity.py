"""Passivity in the time domain: the energy through a port is observed and limited.

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
"""Mass of the device's handle as a hand feels it."""

MAX_DAMPING_Ns_m = 150.0
"""Largest damping shown at the handle: a device of that mass, sampled at 1 kHz, shows
250 Ns/m at most."""

MAX_FORCE_N = 5.0
"""Largest force at a hand: what desktop devices can show for long."""


class Port:
    """Energy through one port since it was made.

    Args:
        allowance_J: What may leave beyond what has entered at the other side: force and
            motion that meet with a delay never balance exactly.
        allowance_W: The same, per second; hand and tissue dissipate as much in any
            case.

    Attributes:
        in_J: Energy that has entered the network.
        out_J: Energy that has left it.
    """

    def __init__(self, allowance_J: float = 0.0, allowance_W: float = 0.0) -> None:
        self._max_allowance_J = allowance_J
        self._allowance_W = allowance_W
        self._allowance_J = allowance_J
        self.in_J = 0.0
        self.out_J = 0.0

    @property
    def net_J(self) -> float:
        """What the network has kept of it; below zero it has given more than it got."""
        return self.in_J - self.out_J

    def observe(self, force_N: float, travel_m: float) -> None:
        """Count one interval: the force held over it, and the travel against it."""
        energy_J = force_N * travel_m
        self.in_J += max(energy_J, 0.0)
        self.out_J -= min(energy_J, 0.0)

    def update_budget_J(self, incoming_J: float, dt_s: float) -> float:
        """Return what may still leave when a further time has passed, see the module.

        Unused allowance does not grow: after a quiet insertion it would feed seconds of
        swinging.

        Args:
            incoming_J: Energy that is known to have entered at the other side.
            dt_s: The time that has passed.
        """
        owed_J = self.out_J - incoming_J
        refilled_J = self._allowance_J + self._allowance_W * dt_s
        self._allowance_J = min(refilled_J, self._max_allowance_J + max(owed_J, 0.0))
        return self._allowance_J - owed_J


def passive_fraction(leaving_J: float, budget_J: float) -> float:
    """Return the fraction of a force or a speed with which only the budget leaves.

    It is 0 to 1. Both numbers may be negative: the energy where it enters, the budget
    where too much has left already.
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

    Args:
        max_force_N: Largest force.
    """

    def __init__(self, max_force_N: float = MAX_FORCE_N) -> None:
        # What the hand may get before the news of it has come: one that yields to a
        # spring need not wait.
        super().__init__(allowance_J=1e-3, allowance_W=2e-3)
        self._limit_N = max_force_N
        self._force_N = 0.0
        self._damping_N = 0.0  # the part of the force that is damping
        self._damped_J = 0.0  # what damping has taken
        self._position_m = 0.0

    def update(
        self,
        wanted_N: float,
        position_m: float,
        speed_m_s: float,
        incoming_J: float,
        *,
        dt_s: float,
        ahead_s: float,
        is_coupled: bool = True,
    ) -> float:
        """Return the force to hold over the coming interval.

        It is positive against positive motion.

        Args:
            wanted_N: The force that should be shown.
            position_m: Position of the handle.
            speed_m_s: Its speed.
            incoming_J: Energy that is known to have entered at the other side.
            dt_s: Time since the last call.
            ahead_s: Time until the next call, at most.
            is_coupled: Whether the hand moves the needle; else it feels free.
        """
        # At the first call the travel means nothing, but then no force is held.
        travel_m = position_m - self._position_m
        self.observe(self._force_N, travel_m)
        # What damping has taken is paid back; not to count it would damp for ever
        # after.
        self._damped_J += self._damping_N * travel_m
        owed_J = self.update_budget_J(incoming_J, dt_s) + self._damped_J
        leaving_J = -wanted_N * speed_m_s * ahead_s
        force_N = wanted_N * passive_fraction(leaving_J, owed_J)
        # The largest force that gives a free handle no more than it gave.
        against_m_s = math.copysign(speed_m_s, wanted_N * speed_m_s)
        root_m_s = math.sqrt(
            speed_m_s * speed_m_s + 2.0 * max(self.net_J, 0.0) / HANDLE_kg
        )
        max_N = HANDLE_kg / ahead_s * (against_m_s + root_m_s)
        force_N = math.copysign(min(abs(force_N), max_N), force_N)
        # More than m / Δt, held over an interval, would turn the handle round.
        missing_J = max(-min(owed_J, self.net_J), 0.0)
        max_Ns_m = min(MAX_DAMPING_Ns_m, HANDLE_kg / ahead_s)
        max_J = max_Ns_m * speed_m_s * speed_m_s * ahead_s
        damping_N = passive_fraction(max_J, missing_J) * max_Ns_m * speed_m_s
        self._damping_N = min(max(damping_N, -max_N - force_N), max_N - force_N)
        sum_N = force_N + self._damping_N
        shown_N = self._limit_force_N(sum_N, dt_s, is_coupled=is_coupled)
        if shown_N != sum_N:
            self._damping_N *= shown_N / sum_N
        self._force_N = shown_N
        self._position_m = position_m
        return self._force_N

    def _limit_force_N(
        self, wanted_N: float, dt_s: float, *, is_coupled: bool
    ) -> float:
        """Return a force within the limits of size and growth.

        It may fall at once, which gives nothing away, and then grow the other way. It
        grows to its largest in 10 ms, with 5 N by 500 N/s: a wall of 20 kN/m met at 20
        mm/s wants 400 N/s. A hand that does not move the needle feels free: 0.5 N.
        """
        start_N = abs(self._force_N) if wanted_N * self._force_N > 0.0 else 0.0
        max_N = min(self._limit_N, start_N + self._limit_N / 0.01 * dt_s)
        if not is_coupled:
            max_N = min(max_N, 0.5)
        return min(max(wanted_N, -max_N), max_N)

    def release(self, travel_m: float) -> None:
        """Let go of the force, after about so much travel.

        The travel counts where energy leaves; it is not believed where energy enters.
        """
        self.observe(min(self._force_N * travel_m, 0.0), 1.0)
        self._force_N = 0.0
        self._damping_N = 0.0


class NeedlePort(Port):
    """Observer and controller at the port where a robot moves a needle against a force.

    The force is known only late, so the speed is delayed as much before both are
    multiplied: else a needle that bounces off a wall, the force still high while it
    retreats, seems to bring energy. A delayed force is shown too low while it rises, so
    the hand always owes some: the allowance.

    Args:
        allowance_J: See `Port`.
        allowance_W: See `Port`.
    """

    def __init__(self, allowance_J: float = 0.0, allowance_W: float = 0.0) -> None:
        super().__init__(allowance_J, allowance_W)
        self._lagged_m_s = 0.0

    def update(
        self,
        wanted_m_s: float,
        force_N: float,
        speed_m_s: float,
        incoming_J: float,
        dt_s: float,
    ) -> float:
        """Return the speed to move with over the coming interval.

        It is positive into the tissue.

        Args:
            wanted_m_s: The speed that is asked for.
            force_N: The force against it.
            speed_m_s: The speed now.
            incoming_J: Energy that is known to have entered at the other side.
            dt_s: Time since the last call, and until the next.
        """
        # The lag of the virtual sensor's force, see `InsertionSession.lag_s`.
        self._lagged_m_s += (speed_m_s - self._lagged_m_s) * dt_s / (0.015 + dt_s)
        self.observe(-force_N, self._lagged_m_s * dt_s)
        budget_J = self.update_budget_J(incoming_J, dt_s)
        return wanted_m_s * passive_fraction(force_N * wanted_m_s * dt_s, budget_J)
