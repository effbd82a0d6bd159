"""A robot in JAX: torques of many samples, and parameters by descent on a loss of one's own.

pip install jax
python in_jax.py
"""

import jax
import jax.numpy as jnp
import numpy as np

import deltaid

jax.config.update("jax_enable_x64", True)  # else JAX computes with seven digits

model = deltaid.load("clavel-delta3")
f = deltaid.jax_functions(model)

rng = np.random.default_rng(0)
z = model.home + rng.uniform(-0.1, 0.1, (1000, 3))
qd, qdd = rng.normal(0, 2, (2, 1000, 3))
torques = jax.jit(jax.vmap(f.inverse_dynamics_at, (0, 0, 0, None)))
truth = 1.1 * model.p
measured = torques(z, qd, qdd, truth)


@jax.jit
def loss(p):
    """Mean absolute error of the torque: outliers weigh no more than they are."""
    return jnp.abs(torques(z, qd, qdd, p) - measured).mean()


slope = jax.grad(loss)
before = loss(model.p)
p, size = jnp.asarray(model.p), np.where(model.p == 0, 0, np.abs(model.p))
for k in range(200):
    p = p - 0.01 / (1 + 0.05 * k) * size * jnp.sign(slope(p))
print(f"mean absolute error {before:.3f} N m before, {loss(p):.4f} N m after")
