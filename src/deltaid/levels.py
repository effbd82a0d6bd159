"""Numerical levels shared by all rooms: convergence, rounding, and significance."""

# Largest number of rounds of an iteration until it settles: those that converge need far fewer, and
# those that oscillate get no better with more.
ROUNDS = 40
# Largest number of sweeps over recordings, each of which evaluates their motion anew.
SWEEPS = 8
# Largest number of rounds where a rough answer is enough, or each round costs a fit.
FEW_ROUNDS = 4
# Relative change below which an iteration has settled: far below what a recording determines.
SETTLED = 1e-3
# The same for steps that each cost a fit, in standard deviations of the fitted values.
NEAR = 0.2
# The same for logarithms of noise levels and of prior scales, which need only two digits.
LEVEL = 0.02
# Relative sizes that count as zero: of sums whose terms cancel, with 1e-15 of rounding; of singular
# values or terms as a share of the largest, where relevant ones exceed 1e-3; and of noise or a
# prior, far below any accuracy.
ROUNDING, NEGLIGIBLE, FAINT = 1e-12, 1e-9, 1e-6
# Significance in standard deviations: noise mostly stays below the first and seldom exceeds the
# second; white noise exceeds the third once in two million, and no noise reaches the fourth.
LIKELY, SURE, CERTAIN, STRONG = 2.0, 3.0, 5.0, 6.0
# Probabilities below which chance is ruled out: for one test, and for very many.
UNLIKELY, NEVER = 0.01, 1e-6
# Shares of a value: a smaller part is negligible, for no recording or description is more accurate;
# and a value with a smaller error or uncertainty counts as exact.
HARDLY, EXACT = 1e-3, 1e-4
# Factor on a described or usual prior width from which a prior has no effect; a value farther from
# its prior than this is no plausible one.
WIDER = 10.0
# Usual noise of a drive's torque, as a share of its largest; drives have 0.3 to 3 %.
TORQUE_NOISE = 0.02
# Standard gravity, unless the description states another value [m/s²].
GRAVITY = 9.81
