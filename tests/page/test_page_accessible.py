"""The page for who does not see well, or uses no mouse: by axe-core, and by rules that it leaves open."""

from collections.abc import Iterator
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import pytest

from onboard.page.follow import LogFrames
from onboard.recording.reader import LogReader
from tests.page.browser import Tab, opened

pytestmark = pytest.mark.realtime
AXE = find_spec("axe_core_python")
SCREENS = [(*size, scheme) for size in ((1280, 800), (390, 844)) for scheme in ("light", "dark")]


@pytest.fixture
def page(tab: Tab, made_log: Path) -> Iterator[Tab]:
    """A log's last frame, everything unfolded."""
    with opened(tab, LogFrames(LogReader(made_log))):
        tab.wait("document.querySelector('.answer[data-name]') !== null")
        tab.run("document.querySelectorAll('details').forEach(one => { one.open = true; })")
        yield tab


@pytest.mark.skipif(AXE is None, reason="axe-core is not here: pip install axe-core-python")
@pytest.mark.parametrize("screen", SCREENS)
def test_axe_finds_nothing_serious(page: Tab, screen: tuple[int, int, str]) -> None:
    assert AXE is not None
    assert AXE.origin is not None
    page.screen(*screen)
    page.run(Path(AXE.origin).with_name("axe.min.js").read_text() + "; 1")
    for stale in ("false", "true"):
        page.run(f"document.body.classList.toggle('stale', {stale})")
        passes, violations = page.run("""axe.run().then(found => [found.passes.length,
            found.violations.map(one => [one.id, one.impact, one.nodes.map(node => node.html)])])""")
        assert passes > 20
        assert [one for one in violations if one[1] in ("serious", "critical")] == []


@pytest.mark.parametrize("screen", SCREENS)
def test_every_text_has_contrast(page: Tab, screen: tuple[int, int, str]) -> None:
    """WCAG 1.4.3: 4.5, of large type 3; against the next background that is not transparent, which axe leaves open
    beside a gradient or below a canvas."""
    page.screen(*screen)
    weak, count = page.run("""(() => {
        const numbers = colour => colour.match(/[\\d.]+/g).map(Number);
        const opaque = colour => (numbers(colour)[3] ?? 1) > 0;
        const light = colour => numbers(colour).slice(0, 3).map(one => one / 255)
            .map(one => one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4)
            .reduce((sum, one, i) => sum + one * [0.2126, 0.7152, 0.0722][i], 0.05);
        const told = [...document.querySelectorAll('body *')].filter(one => one.checkVisibility()
            && [...one.childNodes].some(node => node.nodeType === 3 && node.textContent.trim()));
        return [told.filter(one => {
            const style = getComputedStyle(one), size = parseFloat(style.fontSize);
            let below = one;
            while (below.parentElement && !opaque(getComputedStyle(below).backgroundColor)) below = below.parentElement;
            const two = [light(style.color), light(getComputedStyle(below).backgroundColor)].sort((a, b) => b - a);
            const large = size >= 24 || size >= 18.66 && style.fontWeight >= 700;
            return two[0] / two[1] < (large ? 3 : 4.5);
        }).map(one => one.outerHTML), told.length];
    })()""")
    assert weak == []
    assert count > 40


def test_names_language_headings_and_focus(page: Tab) -> None:
    unnamed = """[...document.querySelectorAll('input, select, button, svg, section')].filter(one =>
        !one.labels?.length && !one.getAttribute('aria-label') && !one.getAttribute('aria-labelledby')
        && !one.textContent.trim() && !one.closest('[hidden]')).map(one => one.outerHTML)"""
    assert page.run(unnamed) == []
    assert page.run("document.documentElement.lang") == "en"
    assert page.run("document.querySelectorAll('main').length") == 1
    levels = page.run("[...document.querySelectorAll('h1, h2, h3, h4')].map(one => +one.tagName[1])")
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    unseen = """[...document.querySelectorAll('input, select, button, summary, [tabindex]')].filter(one => {
        one.focus({focusVisible: true});
        const style = getComputedStyle(one);
        return one.checkVisibility() && (document.activeElement !== one || style.outlineStyle !== 'solid'
            || parseFloat(style.outlineWidth) < 2);
    }).map(one => one.outerHTML)"""
    assert page.run(unseen) == []
