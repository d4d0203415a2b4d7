"""What a page with viser's scene may run and fetch: its own scripts, nothing else.

The second wall behind `page_text`: a script that came in by a name has no nonce, and
nothing can be fetched from elsewhere.
"""

VISERS_LOADER = 'document.createElement("script");'
"""How viser's page adds its unpacked program to itself."""


def page_policy(nonce: str, *sources: str) -> str:
    """Return the content security policy of a page.

    Args:
        nonce: What a script must carry to be run.
        sources: Addresses with which the page may speak.
    """
    return "; ".join(
        (
            "default-src 'none'",
            # viser's WebAssembly builds functions from text; only a script with the
            # nonce gets that far.
            f"script-src 'nonce-{nonce}' 'unsafe-eval'",
            "worker-src blob: data:",
            " ".join(("connect-src blob: data:", *sources)),
            "img-src blob: data:",
            "font-src data:",
            "style-src 'unsafe-inline'",
            "base-uri 'none'",
            "form-action 'none'",
        )
    )


def with_nonce(viser_page: str, nonce: str) -> str:
    """Return viser's page with a nonce on each of its scripts."""
    marked = viser_page.replace("<script", f'<script nonce="{nonce}"')
    return marked.replace(VISERS_LOADER, f'{VISERS_LOADER}e.nonce="{nonce}";')
