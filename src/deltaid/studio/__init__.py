"""The studio: a local page that guides users from a robot and its recordings to a model.

Modules here are independent of the page's library; those of `pages/` draw one stage each.
"""
