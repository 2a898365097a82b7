"""A browser without a window, for the tests of pages."""

import os
import shutil
import subprocess

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")

HEADLESS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--v=0",
)


@pytest.fixture(scope="module")
def browser():
    """The program of a browser; root on Debian may fetch one."""
    found = [path for path in map(shutil.which, BROWSERS) if path]
    if not found and shutil.which("apt-get") and hasattr(os, "geteuid") and os.geteuid() == 0:
        try:
            # The other process of `-n 2` may be at it too.
            apt = ["apt-get", "-o", "DPkg::Lock::Timeout=300"]
            subprocess.run([*apt, "update"], timeout=120, check=True, capture_output=True)
            subprocess.run([*apt, "install", "-y", "chromium"], timeout=600, check=True, capture_output=True)
        except (subprocess.SubprocessError, OSError) as error:
            pytest.skip(f"no browser, and none can be installed: {error}")
        found = [path for path in map(shutil.which, BROWSERS) if path]
    if not found:
        pytest.skip("no browser")
    return found[0]
