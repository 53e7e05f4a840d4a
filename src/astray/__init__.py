"""astray finds out which goal a trained agent really pursues."""

from importlib.metadata import version

from astray import envs

__version__ = version("astray")

envs.register()
