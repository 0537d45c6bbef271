"""The world and the receiver: what is true, and what would be measured.

A `WorldConfig` and a seed in, a `Recording` out (`world.simulate`), or a prepared `World` that measures pose by pose.
`city`, `rays`, `vehicle` and `lte` are its parts, `world` puts them together, `recording` is what the rest of the
package sees of it.
"""
