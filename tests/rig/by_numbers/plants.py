"""Plants that others have written down, as the keys of a scenario.

* Two masses between walls: python-control's ``examples/era_msd.py``, after Kelly's "Mechanical
  Vibrations", example 6.7; two forces, the position of the first mass.
* Distillation column: ``examples/singular-values-plot.ipynb``, after Skogestad and Postlethwaite,
  (3.81); two flows with gains of opposite sign, one product, minutes for seconds.
* Short period of an aircraft with an elevator and a canard, the pitch rate: of the size of a
  fighter's.
"""

from pathlib import Path

TWO_MASSES = """
[plant]
kind = "state-space"
a = [[0, 0, 1, 0], [0, 0, 0, 1], [-6, 2, -2, 1], [1, -4, 0.5, -1.5]]
b = [[0, 0], [0, 0], [1, 0], [0, 0.5]]
c = [1, 0, 0, 0]
input_1 = { name = "force 1", unit = "N" }
input_2 = { name = "force 2", unit = "N" }
output = { name = "position", unit = "m" }
sensor.noise_mps2 = 0.001
[design]
tau_s = 0.01
alpha = 4
tau_q_s = 0.056
alpha_q = 3
"""
COLUMN = """
[plant]
kind = "transfer-functions"
g1 = { num = [87.8], den = [75, 1] }
g2 = { num = [-86.4], den = [75, 1] }
input_1 = { name = "reflux", unit = "mol/s" }
input_2 = { name = "boilup", unit = "mol/s" }
output = { name = "purity", unit = "%" }
[design]
tau_s = 0.5
tau_q_s = 2.0
alpha_q = 2
"""
AIRCRAFT = """
[plant]
kind = "state-space"
a = [[-1.0, 0.98], [-4.0, -1.2]]
b = [[-0.05, 0.02], [-3.5, 1.5]]
c = [0, 1]
input_1 = { name = "elevator", unit = "rad" }
input_2 = { name = "canard", unit = "rad" }
output = { name = "pitch rate", unit = "rad/s" }
torque_actuator.lag_s = 0.03
force_difference_actuator.lag_s = 0.03
[design]
tau_s = 0.02
alpha = 2
tau_q_s = 0.08
alpha_q = 3
[limits]
torque_nm = 0.4
force_difference_n = 0.5
"""
REST = """
estimator = "zoh"
compensation = "on-confirmation"
[reference]
amplitude_mps2 = {amplitude}
[fault]
kind = "actuator-dead"
at_s = 5.0
[budget]
box = {box}
"""
PLANTS = {
    "two-masses": (TWO_MASSES, 0.01, 1.0, 0.2),
    "column": (COLUMN, 0.1, 1.0, 0.05),
    "aircraft": (AIRCRAFT, 0.01, 0.1, 0.1),
}
"""Keys, tick in s, amplitude of the reference, share of the budget's box."""


def written(folder: Path, name: str) -> str:
    """A scenario file of one of ``PLANTS``; its path."""
    text, tick_s, amplitude, box = PLANTS[name]
    head, design, rest = text.partition("[design]\n")
    tuning, limits, sizes = rest.partition("[limits]\n")
    common = REST.format(amplitude=amplitude, box=box)
    path = folder / f"{name}.toml"
    path.write_text(
        f"tick_s = {tick_s}\nlatency_ticks = 1\n{head}{limits}{sizes}{design}{tuning}{common}"
    )
    return str(path)
