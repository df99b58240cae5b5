"""A tank whose level a PI controller holds, as a co-simulation FMU by pythonfmu."""

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Tank(Fmi2Slave):
    """Fills to 1 m; the pump gives up to 0.3 m^3/s, and follows with a lag of 2 s."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.kp, self.ki = 1.0, 0.05
        self.area, self.outflow = 1.0, 0.1  # [m^2], [m^2.5/s]
        self.level, self.integral, self.flow = 0.0, 0.0, 0.0
        for name in ("kp", "ki", "area", "outflow"):
            self.register_variable(
                Real(
                    name,
                    causality=Fmi2Causality.parameter,
                    variability=Fmi2Variability.tunable,
                )
            )
        self.register_variable(Real("level", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        """Go on by explicit Euler steps, the integrator held while the pump is at its limit."""
        error = 1.0 - self.level
        wanted = self.kp * error + self.integral
        possible = min(max(wanted, 0.0), 0.3)
        if possible == wanted:
            self.integral += self.ki * error * step_size
        self.flow += step_size * (possible - self.flow) / 2.0
        self.level += (
            step_size * (self.flow - self.outflow * max(self.level, 0.0) ** 0.5) / self.area
        )
        return True
