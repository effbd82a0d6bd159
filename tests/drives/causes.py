"""The second table of rows: undeclared faults, alone or in random mixtures.

A cause adds a fault of a given size to a recording, which may have several. Its other properties,
such as drive and direction, are random, and `Case.drawn` states them.
"""

from drives.drivetrain import presliding
from drives.made import Faults
from drives.measured import falling_gain, gear_ratio, ripple, saturation, zeros
from drives.mixture import Mixture
from drives.rows import LENGTHS
from drives.undescribed import (
    askew,
    asymmetric,
    balancer,
    ball_joints,
    cable,
    force,
    heavy_limb,
    hose,
    long_limb,
    mounting,
    spring,
    tilt,
)

CAUSES: dict[str, Faults | Mixture] = {
    "ripple": Faults("ripple of 3 %", ((ripple, 0.03),)),
    "clean-ripple": Faults("ripple of 0.5 %", ((ripple, 0.005),)),
    "homing-0.3": Faults("homing 0.3° off, not stated", ((zeros, 0.3),)),
    "homing-0.5": Faults("homing 0.5° off, not stated", ((zeros, 0.5),)),
    "hose": Faults("5 N, 1 to 3 N of drag, 50 N/m at the platform", ((hose, 5.0),)),
    "force": Faults("5 N at the platform", ((force, 5.0),)),
    "spring": Faults("50 N/m at the platform", ((spring, 50.0),)),
    "cable": Faults("a cable that pulls with 5 N, 30 N/m", ((cable, 5.0),)),
    "hose-tilted": Faults("a hose and a tilt of 1°", ((hose, 5.0), (tilt, 1.0))),
    "falling-gain": Faults("torque constants −15 % at full current", ((falling_gain, 0.15),)),
    "saturation": Faults("motors that saturate at 90 %", ((saturation, 0.9),)),
    "gear-ratio": Faults("gear ratio of one drive 1 % off", ((gear_ratio, 0.01),)),
    "long-limb": Faults("arm or strut of one limb 1 mm longer", ((long_limb, LENGTHS),)),
    "mounting": Faults("one limb mounted 1 to 3 mm and 4 to 12 mrad off",
                       ((mounting, (1e-3, 3e-3)),)),
    "heavy-limb": Faults("arm of one limb 20 to 50 % heavier", ((heavy_limb, (0.2, 0.5)),)),
    "balancer": Faults("springs at the drives, 3 to 10 % of the torque",
                       ((balancer, (0.03, 0.1)),)),
    "ball-joints": Faults("ball joints with 0.1 to 0.5 N m of friction",
                          ((ball_joints, (0.1, 0.5)),)),
    "presliding": Faults("friction yields over 0.2 to 2 % of the stroke",
                         ((presliding, (0.002, 0.02)),)),
    "tilt": Faults("base tilted by 2°", ((tilt, 2.0),)),
    "asymmetric": Faults("centres 1 and 4 mm off, axes turned by 0.2 to 2°", ((asymmetric, 1.0),)),
    "askew": Faults("the same, turned about their joints", ((askew, 1.0),)),
    "mixture": Mixture("3 to 5 faults of random sizes"),
}  # fmt: skip
