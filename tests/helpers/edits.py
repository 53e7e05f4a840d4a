"""Sources as a process that begins after an edit would find them."""

from astray import provenance


def forget(monkeypatch):
    """Let sources be read anew, as in a process that begins now."""
    monkeypatch.setattr(provenance, "_loaded", {})


def edit(monkeypatch, *modules):
    """Let the sources of modules be others."""
    real = provenance.read_source

    def read(spec):
        return (real(spec) or b"") + b"# edited" * (spec is not None and spec.name in modules)

    monkeypatch.setattr(provenance, "read_source", read)
    forget(monkeypatch)
