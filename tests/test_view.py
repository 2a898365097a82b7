"""The page that shows a scene while its numbers move: what it answers, and what it refuses."""

import io
import json
import re
import subprocess
import threading
import urllib.error
import urllib.request

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from browsers import HEADLESS
from browsers import browser as browser
from PIL import Image
from scenes import assignment_scene

from raytrace_jax import ParameterError, set_parameters
from raytrace_jax.cli import main
from raytrace_jax.images.png import encode_course
from raytrace_jax.report.live.server import answer, make_server, render_page
from raytrace_jax.report.live.studio import Slider, Studio
from raytrace_jax.tracer.derivatives import picture_derivatives
from raytrace_jax.tracer.rendering import render
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

SETTINGS = ResolvedSettings(size=(40, 30), max_bounces=2)
SLIDERS = Slider("vitreous.ior", 1.0, 2.4), Slider("vitreous.center.x", 2.0, 6.0)

INSIDE = np.s_[..., 1:-1]
"""Rounding decides the first and the last column of this scene."""


@pytest.fixture(scope="module")
def studio():
    return Studio(assignment_scene(), SETTINGS, SLIDERS, "course")


def pixels(body):
    return np.moveaxis(np.asarray(Image.open(io.BytesIO(body))), -1, 0)


def test_pictures_are_those_of_the_moved_scene(studio):
    body, kind, code = answer(studio, b"", "/picture.png?vitreous.ior=1.8&vitreous.center.x=3.5")
    moved = set_parameters(assignment_scene(), {"vitreous.ior": 1.8, "vitreous.center.x": 3.5})
    assert (kind, code) == ("image/png", 200)
    expected = encode_course(np.asarray(render(moved, SETTINGS).image))
    np.testing.assert_array_equal(pixels(body)[INSIDE], expected[INSIDE])


@pytest.mark.slow
def test_derivatives_are_those_of_the_picture(studio):
    _, columns, _ = studio.derive(*tangent(studio, "vitreous.center.x"))
    expected = picture_derivatives(assignment_scene(), ["vitreous.center.x"], SETTINGS).values[0]
    np.testing.assert_allclose(columns[INSIDE], expected[INSIDE], atol=1e-9 * np.abs(expected).max())
    body, _, _ = answer(studio, b"", "/derivative.png?by=vitreous.center.x")
    shown, sign = pixels(body).astype(int), np.asarray(expected).mean(axis=0)
    strong = np.abs(sign) > 0.2 * np.percentile(np.abs(sign), 99.5)
    assert strong.sum() > 10 and np.all(np.sign(shown[0] - shown[2])[strong] == np.sign(sign)[strong])


def tangent(studio, name):
    scene, value = studio.scene, jnp.asarray(studio.scene[name])
    _, along = jax.jvp(lambda x: set_parameters(scene, {name: x}), (value,), (jnp.ones_like(value),))
    return scene, along


def test_rays_are_those_of_the_pixel(studio):
    body, kind, _ = answer(studio, b"", "/rays.svg?column=19&row=14")
    assert kind == "image/svg+xml" and b"pixel 19 14" in body


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/picture.png?vitreous.ior=-1", "greater than 0"),
        ("/picture.png?vitreous.ior=much", "vitreous.ior is 'much'"),
        ("/picture.png?vitreous.ior=nan", "vitreous.ior"),
        ("/derivative.png?by=cyan.alpha", "there are vitreous.ior, vitreous.center.x"),
        ("/rays.svg?row=3", "column is None"),
    ],
)
def test_what_cannot_be_is_refused(studio, path, words):
    with pytest.raises(ParameterError, match=words):
        answer(studio, b"", path)


def test_the_server_answers_and_says_what_is_wrong(studio):
    with make_server(studio, "a <scene>") as server:
        threading.Thread(target=lambda: [server.handle_request() for _ in range(3)], daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        with urllib.request.urlopen(address) as reply:
            page = reply.read().decode()
        assert "a &lt;scene&gt;" in page and page.count('type="range"') == 2
        for path, code in (("/other", 404), ("/picture.png?vitreous.ior=0", 400)):
            with pytest.raises(urllib.error.HTTPError) as caught:
                urllib.request.urlopen(address + path)
            assert caught.value.code == code and caught.value.read()
    assert "https://" not in render_page(studio, "a") and "http://" not in render_page(studio, "a")


@pytest.mark.parametrize(
    ("over", "words"),
    [
        (["vitreous.ior"], "NAME=START:STOP"),
        (["vitreous.ior=2:1"], "upwards"),
        (["vitreous.ior=2:3"], "lies outside"),
        (["vitreous.center=0:9"], "is a vector"),
        (["vitreous.iro=0:9"], "ior"),
        (["vitreous.ior=1:2", "cyan.ior=1:2"], "give it once"),
    ],
)
def test_the_command_refuses_sliders_that_cannot_be(over, words, capsys):
    assert main(["view", "vitreous", "--over", *over]) == 2
    assert words in capsys.readouterr().err


HAND = """<script>
// As a hand would: drag the first slider, choose a derivative, click on the ball. Then say what is seen.
const rest = async () => { do await new Promise(go => setTimeout(go, 50)); while (busy || wanted); };
const look = async image => {
  await image.decode();
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
  const pen = canvas.getContext("2d");
  pen.drawImage(image, 0, 0);
  return [...pen.getImageData(0, 0, canvas.width, canvas.height).data];
};
addEventListener("load", async () => {
  const seen = {}, picture = byId("picture"), by = byId("by"), box = picture.getBoundingClientRect();
  await rest();
  seen.before = await look(picture);
  inputs[0].value = 1.8;
  inputs[0].dispatchEvent(new Event("input"));
  await rest();
  seen.after = await look(picture);
  by.value = inputs[0].dataset.name;
  by.dispatchEvent(new Event("change"));
  await rest();
  seen.derivative = await look(byId("derivative"));
  const middle = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 };
  picture.dispatchEvent(new MouseEvent("click", middle));
  await rest();
  await byId("tree").decode();
  Object.assign(seen, { rays: byId("tree").naturalWidth, value: inputs[0].value, error: byId("error").textContent });
  document.title = JSON.stringify(seen);
});
</script>"""


@pytest.mark.slow
def test_a_hand_on_the_sliders_moves_picture_derivative_and_rays(studio, browser, monkeypatch, tmp_path):
    page = render_page(studio, "a scene").replace("</body>", f"{HAND}</body>")
    monkeypatch.setattr("raytrace_jax.report.live.server.render_page", lambda *_: page)
    with make_server(studio, "a scene") as server, (tmp_path / "dom").open("w+", encoding="utf-8") as dom:
        options = [*HEADLESS, f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=60000", "--dump-dom"]
        address = f"http://127.0.0.1:{server.server_port}/"
        server.timeout = 0.1
        with subprocess.Popen([browser, *options, address], stdout=dom, stderr=subprocess.DEVNULL) as process:
            while process.poll() is None:
                server.handle_request()
        dom.seek(0)
        title = re.search("<title>(.*?)</title>", dom.read(), re.DOTALL)
    assert title is not None and title[1].startswith("{"), title
    seen = json.loads(title[1])
    (before, after, derivative) = (
        np.reshape(seen[name], (30, 40, 4))[..., :3].transpose(2, 0, 1) for name in ("before", "after", "derivative")
    )
    moved = set_parameters(assignment_scene(), {"vitreous.ior": float(seen["value"])})
    for scene, picture in ((assignment_scene(), before), (moved, after)):
        expected = encode_course(np.asarray(render(scene, SETTINGS).image))
        # A browser goes through the screen's profile, which rounds.
        np.testing.assert_allclose(picture[INSIDE], expected[INSIDE].astype(int), atol=1)
    assert np.any(before != after) and len(np.unique(derivative)) > 20
    assert seen["rays"] > 100 and not seen["error"]
