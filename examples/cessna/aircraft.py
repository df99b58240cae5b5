"""A Cessna 172 under JSBSim's own autopilot, without ROS: dynamics, turbulence and control laws.

The aircraft is `c172x` of the JSBSim package, with its autopilot (`c172ap.xml`) and its trim. Eight
gains of heading and altitude hold are tunable: one is a property already, the others are numbers in
that file, which in a copy are replaced by properties of the same value.

The turbulence is JSBSim's (MIL-F-8785C). Below 1000 ft above ground its strength is a tenth of the
wind at a height of 20 ft.
"""

import atexit
import os
import re
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

os.environ.setdefault("JSBSIM_DEBUG", "0")  # no banner; read when JSBSim is loaded
import jsbsim

PERIOD = 1.0 / 120.0
"""Time step [s]; that of the package's scripts for this aircraft."""
START_ALTITUDE = 260.0  # above ground, which is at sea level [m]
START_HEADING = 1.5  # clockwise from north [rad]
SETTLING = 20.0  # time under the gains of the package, in still air, before a flight begins [s]
FOOT, KNOT, POUND = 0.3048, 0.514444, 0.45359237

Signals = dict[str, float]


@dataclass(frozen=True)
class Gain:
    """A gain of the autopilot.

    Attributes
    ----------
    property : str
        JSBSim's name of it.
    text : str
        What it is, and its unit.
    component, tag : str
        Where the number stands in `c172ap.xml`; empty if it is a property there.
    """

    property: str
    text: str
    component: str = ""
    tag: str = ""


_BANK, _CLIMB = "fcs/heading-pi-controller", "fcs/altitude-hold-pid"
GAINS = {
    "heading_lag": Gain("ap/hdg-roll-err-c1", "lag of the wanted bank, as its corner [rad/s]"),
    "bank_p": Gain("ap/bank-p", "aileron on the bank error [1/rad]", _BANK, "kp"),
    "bank_i": Gain("ap/bank-i", "aileron on its integral [1/(rad s)]", _BANK, "ki"),
    "bank_d": Gain("ap/bank-d", "aileron on its rate [s/rad]", _BANK, "kd"),
    "climb_lag": Gain(
        "ap/climb-lag", "lag of the wanted climb, as its corner [rad/s]", "fcs/alt-error-lag", "c1"
    ),
    "climb_p": Gain("ap/climb-p", "elevator on the climb error [s/ft]", _CLIMB, "kp"),
    "climb_i": Gain("ap/climb-i", "elevator on its integral [1/ft]", _CLIMB, "ki"),
    "climb_d": Gain("ap/climb-d", "elevator on its rate [s²/ft]", _CLIMB, "kd"),
}


@dataclass(frozen=True)
class Conditions:
    """What a flight meets.

    Attributes
    ----------
    wind : float
        At a height of 20 ft [m/s]: the turbulence in flight has a tenth of it.
    airspeed : float
        Calibrated, at the start [m/s]; the throttle stays where the trim has put it.
    luggage : float
        In the baggage compartment [kg].
    wing_load : float
        Under the right wing [kg].
    seed : int
        Of the turbulence.
    """

    wind: float = 0.0
    airspeed: float = 100.0 * KNOT
    luggage: float = 120.0 * POUND
    wing_load: float = 80.0 * POUND
    seed: int = 0


@cache
def _copy() -> tuple[str, dict[str, float]]:
    """Copy the aircraft, with gains that can be set; return where to, and the package's values."""
    copy = tempfile.mkdtemp(prefix="c172x-")
    atexit.register(shutil.rmtree, copy, ignore_errors=True)
    folder = Path(copy) / "c172x"
    shutil.copytree(Path(jsbsim.get_default_root_dir()) / "aircraft" / "c172x", folder)
    path = folder / "c172ap.xml"
    text, values = path.read_text(encoding="utf-8"), {}
    for name, gain in GAINS.items():
        if not gain.component:
            found = re.search(rf'<property value="(\S+)">\s*{gain.property}\s*<', text)
        else:
            found = re.search(rf'"{gain.component}">.*?<{gain.tag}>\s*(\S+)\s*<', text, re.DOTALL)
        if found is None:
            raise ValueError(f"{path}: found no gain {name}; expected the autopilot of JSBSim 1.3")
        values[name] = float(found[1])
        if gain.component:
            text = text[: found.start(1)] + gain.property + text[found.end(1) :]
            declared = f'<property value="{found[1]}"> {gain.property} </property>\n'
            text = text.replace("<channel", declared + "<channel", 1)
    path.write_text(text, encoding="utf-8")
    return copy, values


def default_gains() -> dict[str, float]:
    """Return the values of the package."""
    return dict(_copy()[1])


class Aircraft:
    """A flight from level flight at `START_ALTITUDE` and `START_HEADING`, both held.

    Parameters
    ----------
    conditions
        What it meets.
    gains
        Of the autopilot, from the start on; those that are left out are the package's.

    Raises
    ------
    ValueError
        If the aircraft cannot be trimmed in these conditions.
    """

    def __init__(self, conditions: Conditions, gains: Mapping[str, float] | None = None) -> None:
        root = jsbsim.get_default_root_dir()
        fdm = self._fdm = jsbsim.FGFDMExec(root)
        fdm.set_debug_level(0)
        fdm.set_aircraft_path(_copy()[0])
        fdm.load_model("c172x")
        fdm.set_dt(PERIOD)
        fdm["simulation/randomseed"] = fdm["atmosphere/randomseed"] = conditions.seed % 2**31
        fdm["ic/h-agl-ft"] = START_ALTITUDE / FOOT
        fdm["ic/psi-true-rad"] = START_HEADING
        fdm["ic/vc-kts"] = conditions.airspeed / KNOT
        fdm["inertia/pointmass-weight-lbs[4]"] = conditions.luggage / POUND
        fdm["inertia/pointmass-weight-lbs[5]"] = conditions.wing_load / POUND
        fdm.run_ic()
        # Before the trim, which runs the autopilot's filters: without an error they are at rest.
        self.hold(START_ALTITUDE, START_HEADING)
        fdm["propulsion/set-running"] = -1
        fdm["fcs/mixture-cmd-norm"] = 0.9
        try:
            fdm["simulation/do_simple_trim"] = 1
        except jsbsim.TrimFailureError:
            raise ValueError(f"the aircraft cannot be trimmed in {conditions}") from None
        fdm["ap/altitude_hold"] = fdm["ap/heading_hold"] = 1
        for _ in range(round(SETTLING / PERIOD)):
            fdm.run()
        self.set_gains(gains or {})
        fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = conditions.wind / FOOT
        fdm["atmosphere/turbulence/milspec/severity"] = 1  # counts above 2000 ft; 0 is none at all
        fdm["atmosphere/turb-type"] = 3 if conditions.wind > 0.0 else 0
        self._start = fdm.get_sim_time()

    @property
    def time(self) -> float:
        """Time [s] since its start."""
        return float(self._fdm.get_sim_time() - self._start)

    def set_gains(self, gains: Mapping[str, float]) -> None:
        """Change gains of the autopilot in flight."""
        for name, value in gains.items():
            self._fdm[GAINS[name].property] = value

    def hold(self, altitude: float, heading: float) -> None:
        """Tell the autopilot which altitude [m] and heading [rad] to hold."""
        self._fdm["ap/altitude_setpoint"] = altitude / FOOT
        # The autopilot takes a radian for 57.3 degrees.
        self._fdm["ap/heading_setpoint"] = heading * 57.3

    def step(self) -> None:
        """Fly on for `PERIOD`."""
        self._fdm.run()

    def measure(self) -> Signals:
        """Return altitude [m], attitude [rad], airspeed [m/s], and what the surfaces are told."""
        fdm = self._fdm
        return {
            "altitude": fdm["position/h-agl-ft"] * FOOT,
            "heading": fdm["attitude/heading-true-rad"],
            "pitch": fdm["attitude/theta-rad"],
            "bank": fdm["attitude/phi-rad"],
            "airspeed": fdm["velocities/vc-kts"] * KNOT,
            "aileron": fdm["fcs/roll-trim-sum"],
            "elevator": fdm["fcs/pitch-trim-sum"],
        }

    def linearize(self) -> jsbsim.FGLinearization:
        """Return the aircraft as it flies, linearized with the autopilot off."""
        self._fdm["ap/altitude_hold"] = self._fdm["ap/heading_hold"] = 0
        self.step()
        return jsbsim.FGLinearization(self._fdm)
