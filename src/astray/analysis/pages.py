"""Pages and cards from templates, which lie beside the code that fills them."""

from jinja2 import Environment, PackageLoader, StrictUndefined


def templates(package: str, *, markdown: bool = False) -> Environment:
    """Return the templates of a package; values are escaped unless they are `markdown`."""
    return Environment(
        loader=PackageLoader(package, ""),
        autoescape=not markdown,
        keep_trailing_newline=markdown,
        lstrip_blocks=True,
        trim_blocks=True,
        undefined=StrictUndefined,
    )
