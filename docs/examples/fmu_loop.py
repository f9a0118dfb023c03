"""Both FMUs of a scenario in a loop, by FMPy: python fmu_loop.py FOLDER SCENARIO [fmi2|fmi3].

Variables of equal names are connected, and the scenario's reference, faults and noise come from
FOLDER/inputs_SCENARIO.csv. Prints D* and both commands of each tick as CSV.
"""

import csv
import sys
from pathlib import Path

import fmpy
from fmpy.simulation import instantiate_fmu


class Part:
    """An FMU at rest."""

    def __init__(self, path, start):
        self.model = fmpy.read_model_description(str(path))
        self.fmu = instantiate_fmu(fmpy.extract(str(path)), self.model, "CoSimulation")
        is_2 = self.model.fmiVersion.startswith("2")
        self.real, self.whole = ("Real", "Integer") if is_2 else ("Float64", "Int32")
        if is_2:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.set(start)
        self.fmu.exitInitializationMode()
        self.time_s, self.outputs = 0.0, self.get()

    def set(self, values):
        """Set the inputs among ``values``."""
        for each in self.model.modelVariables:
            if each.causality == "input" and each.name in values:
                getattr(self.fmu, f"set{self.real}")([each.valueReference], [values[each.name]])

    def get(self):
        """The outputs by name."""
        found = {}
        for kind in (self.real, self.whole):
            its = [
                each
                for each in self.model.modelVariables
                if each.causality == "output" and each.type == kind
            ]
            values = getattr(self.fmu, f"get{kind}")([each.valueReference for each in its])
            found |= {each.name: value for each, value in zip(its, values, strict=True)}
        return found

    def step(self, values, tick_s):
        """Set inputs and advance by a tick; returns the outputs."""
        self.set(values)
        self.fmu.doStep(self.time_s, tick_s)
        self.time_s += tick_s
        self.outputs = self.get()
        return self.outputs


def loop(folder, scenario, version="fmi3"):
    """The outputs of both FMUs in each tick; `measurement` is what the controller gets."""
    name = scenario.replace("-", "_")
    with (Path(folder) / f"inputs_{name}.csv").open(encoding="utf-8") as file:
        first, *rows = [
            {name: float(value) for name, value in row.items()} for row in csv.DictReader(file)
        ]
    controller, car = (
        Part(Path(folder) / version / f"{part}_{name}.fmu", first) for part in ("controller", "car")
    )
    tick_s = float(car.model.defaultExperiment.stepSize)
    for row in rows:
        now = {**row, **car.outputs}
        now |= controller.step(now, tick_s)
        yield now
        car.step(now, tick_s)


if __name__ == "__main__":
    print("time,measurement,command_1,command_2")
    for tick in loop(*sys.argv[1:]):
        print(*(tick[name] for name in ("time", "measurement", "command_1", "command_2")), sep=",")
