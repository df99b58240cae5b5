"""The points of a figure, as a reader with a mouse meets them."""

MIDDLES = """
    [...document.querySelectorAll('#{figure} .plot:first-child use[data-trial]')].map(m => {{
    const r = m.getBoundingClientRect();
    return [Number(m.dataset.trial), r.x + r.width / 2, r.y + r.height / 2]; }})"""


def middles(browser, figure):
    """Trial and middle [px] of each point in the first panel of a figure, which is scrolled to."""
    browser.evaluate(
        f"document.querySelector('#{figure} .plot').scrollIntoView({{block: 'center'}})"
    )
    return browser.evaluate(MIDDLES.format(figure=figure))


def mouse(browser, kind, x, y, **more):
    """What a mouse does at a place of the window [px]."""
    browser.call("Input.dispatchMouseEvent", type=f"mouse{kind}", x=x, y=y, **more)


def press(browser, figure, trial):
    """Click on the point of a trial."""
    x, y = next((x, y) for number, x, y in middles(browser, figure) if number == trial)
    mouse(browser, "Moved", x, y)
    for kind in ("Pressed", "Released"):
        mouse(browser, kind, x, y, button="left", clickCount=1)
