"""The studio: a local page that guides from a robot and its recordings to a model.

Modules here know no window; those of `pages/` draw one stage each.
"""
