"""Levels that all rooms share: what is settled, what is rounding, what chance hardly does."""

# Rounds of an iteration that is repeated until it settles, at most: those that converge do so long
# before, and those that go to and fro are as good after so many as after more.
ROUNDS = 40
# The same of sweeps over recordings, whose motion is evaluated anew in each.
SWEEPS = 8
# The same where a first answer is enough, or each round costs a fit.
FEW_ROUNDS = 4
# The change, as a share of what is iterated, below which it has settled: far below what a recording
# determines.
SETTLED = 1e-3
# The same of steps that each cost a fit, in standard deviations of what is fitted.
NEAR = 0.2
# The same of logarithms of noise levels and of scales of priors, which nobody needs to more digits.
LEVEL = 0.02
# Shares that are nothing: of sums whose terms cancel, which leave 1e-15; of the largest singular
# value or term, where what matters makes 1e-3; and of noise or a prior, far below any accuracy.
ROUNDING, NEGLIGIBLE, FAINT = 1e-12, 1e-9, 1e-6
# Standard deviations: noise mostly stays below the first and seldom exceeds the second; beyond the
# third, chance makes one of two million; beyond the fourth, noise of any colour is none.
LIKELY, SURE, CERTAIN, STRONG = 2.0, 3.0, 5.0, 6.0
# Probabilities of what is not taken for chance: of one test, and of one of very many.
UNLIKELY, NEVER = 0.01, 1e-6
# Shares of a value: what is less is nothing beside it, for no recording or description is better;
# and what is known to less is as good as exact.
HARDLY, EXACT = 1e-3, 1e-4
# A prior that is so many times as wide as described or usual binds nothing; what is farther off is
# another thing.
WIDER = 10.0
# Standard gravity where none is stated [m/s²].
GRAVITY = 9.81
