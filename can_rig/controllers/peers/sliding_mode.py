"""Sliding-mode control of the demand, with on-line control allocation.

σ = e + ∫e/λ slides by v = ∫ki e + ρ σ/(|σ| + δ), the unit vector with a boundary layer δ; the
demand v goes to the actuators by their effectiveness (Alwi and Edwards, Automatica 44, 2008), which
``LossObserver`` finds as ``Allocation`` does. Here σ has the output alone, for the measurement is
the output alone.
"""

from can_rig.controllers.peers.allocation import Allocation
from can_rig.controllers.setup import ControllerSetup


class SlidingMode(Allocation):
    """Parameters of ``Allocation``, and ``rho_mps2`` and ``boundary_mps2``: ρ and δ."""

    def __init__(self, setup: ControllerSetup) -> None:
        super().__init__(setup)
        self.rho = setup.number("rho_mps2", 1.0)
        self.boundary = setup.number("boundary_mps2", 1.0)
        self.sum_per_error = setup.tick_s / setup.number("lambda_s", 0.3)
        self.sum = 0.0

    def reset(self, reference: float) -> None:
        """See ``Allocation``."""
        super().reset(reference)
        self.sum = 0.0

    def demand(self, error: float) -> float:
        """See ``Allocation``."""
        self.sum += self.sum_per_error * error
        self.integral += self.ki * error
        sigma = error + self.sum
        return self.integral + self.rho * sigma / (abs(sigma) + self.boundary)
