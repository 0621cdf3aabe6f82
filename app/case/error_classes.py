"""Classes of numbers by their discretization errors, with the factors of the error estimate.

`app.results.error_estimate` has the equations. Its factors were fitted class by class
(docs/verification.md). Each class is one row here.
"""

from __future__ import annotations

from dataclasses import dataclass

# A value at first and at second order.
ByOrder = tuple[float, float]


@dataclass(frozen=True)
class ErrorClass:
    """Numbers whose errors are estimated with the same factors, each at first and second order [-].

    A class without factors has those of Richardson's extrapolation.

    Attributes:
        name: Name in tables, such as ``motions``.
        orders: Orders of convergence p.
        change_factors: Factors a on the change to a coarser mesh. None: 1 / (2^p - 1), and the
            numbers have no part in medians.
        median_factors: Factors b on the median change of a group.
        median_factors_of_parts: Factors b of numbers of parts, such as a rim.
        press_fit_factors: Factors on the errors of cases with a press fit.
        two_mesh_factors: Factors on the changes to two coarser meshes, the finer first, at both
            orders. None: only the finer mesh counts.
        median_group: Name that classes with one median share; by default that of the class.
    """

    name: str
    orders: ByOrder
    change_factors: ByOrder | None = None
    median_factors: ByOrder = (0.0, 0.0)
    median_factors_of_parts: ByOrder = (0.0, 0.0)
    press_fit_factors: ByOrder = (1.0, 1.0)
    two_mesh_factors: tuple[float, float] | None = None
    median_group: str = ""

    def __post_init__(self) -> None:
        """Fill in the defaults."""
        object.__setattr__(self, "median_group", self.median_group or self.name)

    def change_factor(self, degree_index: int) -> float:
        """Factor a at an order of the displacement, given less one."""
        if self.change_factors is None:
            return 1 / (2 ** self.orders[degree_index] - 1)
        return self.change_factors[degree_index]

    def median_factor(self, degree_index: int, of_part: bool) -> float:
        """Factor b at an order of the displacement, given less one, of a part or a whole."""
        factors = self.median_factors_of_parts if of_part else self.median_factors
        return factors[degree_index]


# Displacements.
MOTION_ERRORS = ErrorClass(
    "motions",
    orders=(0.8, 1.3),
    change_factors=(2.8, 0.7),
    median_factors=(6.0, 0.8),
    median_factors_of_parts=(3.5, 1.75),
    press_fit_factors=(1.6, 1.0),
)
# Slip.
SLIP_ERRORS = ErrorClass(
    "slips",
    orders=(0.8, 1.2),
    change_factors=(3.6, 0.35),
    median_factors=(7.0, 1.75),
    median_factors_of_parts=(6.0, 3.25),
    press_fit_factors=(1.2, 3.5),
    median_group="motions",
)
# Contact pressure, shear stress and what they wear.
TRACTION_ERRORS = ErrorClass(
    "tractions",
    orders=(0.8, 0.8),
    change_factors=(2.0, 0.6),
    median_factors=(1.4, 1.05),
    median_factors_of_parts=(3.0, 2.5),
    press_fit_factors=(6.0, 2.5),
    median_group="motions",
)
# Stress in regions.
STRESS_ERRORS = ErrorClass(
    "stresses",
    orders=(0.8, 1.0),
    change_factors=(3.8, 1.8),
    median_factors=(3.0, 0.2),
    median_factors_of_parts=(2.5, 0.5),
    press_fit_factors=(1.3, 1.0),
    median_group="motions",
)
# Powers of stress, and volumes in which it exceeds a level.
RISK_ERRORS = ErrorClass(
    "risks",
    orders=(0.8, 0.99),
    change_factors=(3.8, 1.8),
    median_factors=(3.0, 0.2),
    median_factors_of_parts=(2.5, 0.5),
)
# Temperature.
TEMPERATURE_ERRORS = ErrorClass(
    "temperatures",
    orders=(1.5, 1.5),
    change_factors=(3.0, 3.0),
    two_mesh_factors=(1.75, 1.25),
)
# Thermal doses, times and cure.
DOSE_ERRORS = ErrorClass(
    "doses, times, cure",
    orders=(1.0, 1.0),
    change_factors=(5.0, 5.0),
    median_factors=(1.5, 1.5),
    median_factors_of_parts=(5.0, 1.5),
)
