"""The page that shows a scene while its numbers move: what it answers, and what it refuses."""

import base64
import dataclasses
import html
import io
import json
import socket
import subprocess
import threading
import time
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

from raytrace_jax import ParameterError, parse_scene, picture_derivatives, render, set_parameters
from raytrace_jax.cli.actions.explain import first_glass
from raytrace_jax.images.transfer import encode_course
from raytrace_jax.report.derivatives import scale_limit
from raytrace_jax.report.live import Slider, Studio, answer, make_server, render_page, saved_page, scale_of
from raytrace_jax.report.panels import signed_pixels
from raytrace_jax.tracer.ray_tree import trace_tree
from raytrace_jax.tracer.rendering import PictureDerivatives
from raytrace_jax.tracer.settings import ResolvedSettings

SETTINGS = ResolvedSettings(size=(40, 30), max_bounces=2)
SLIDERS = Slider("vitreous.ior", 1.0, 2.4), Slider("vitreous.center.x", 2.0, 6.0)

INSIDE = np.s_[..., 1:-1]
"""Rounding decides the first and the last column of this scene."""


@pytest.fixture(scope="module")
def studio():
    return Studio(assignment_scene(), SETTINGS, SLIDERS, "course")


def test_a_prism_has_sliders_that_turn_it_about_its_edge():
    scene = parse_scene(
        "settings main { model physical } camera eye { pixeldim 8 6 viewpoint 0 0 5 lookat 0 0 0 }"
        "material glass { transmission 1 } prism wedge { material glass point 1 2 3 axis 0 0 1 down 0 -2 0 apex 60 }"
    )
    sliders = {slider.name: slider[1:] for slider in first_glass(scene, "physical")}
    assert sliders == {
        "wedge.ior": (1, 2.4),
        **{f"wedge.point.{axis}": (x - 2, x + 2) for axis, x in zip("xyz", (1, 2, 3), strict=True)},
        "wedge.apex": (20, 90),
        "wedge.down.x": (-2, 2),
        "wedge.down.y": (-2, 2),
    }
    for name, ends in sliders.items():
        for value in ends:
            assert float(set_parameters(scene, {name: value})[name]) == value


def told(studio, path):
    body, kind, code = answer(studio, "", path)
    assert (kind, code) == ("application/json", 200)
    return json.loads(body)


def image_of(reply, kind="image/png"):
    start, _, text = reply["image"].partition(",")
    assert start == f"data:{kind};base64"
    return base64.b64decode(text)


def pixels(reply):
    return np.moveaxis(np.asarray(Image.open(io.BytesIO(image_of(reply)))), -1, 0)


def test_pictures_are_of_the_moved_scene(studio):
    reply = told(studio, "/picture?vitreous.ior=1.8&vitreous.center.x=3.5")
    moved = set_parameters(assignment_scene(), {"vitreous.ior": 1.8, "vitreous.center.x": 3.5})
    expected = encode_course(np.asarray(render(moved, SETTINGS).image))
    np.testing.assert_array_equal(pixels(reply)[INSIDE], expected[INSIDE])


@pytest.mark.slow
def test_pictures_of_areas_follow(studio):
    reply = told(studio, "/areas?vitreous.ior=1.8")
    moved = set_parameters(assignment_scene(), {"vitreous.ior": 1.8})
    image = np.asarray(render(moved, dataclasses.replace(SETTINGS, edges="aware")).image)
    np.testing.assert_array_equal(pixels(reply), encode_course(image))


def test_the_first_hit_is_said(studio):
    node = trace_tree(studio.scene, (19, 14), SETTINGS).nodes[0]
    words = told(studio, "/rays?column=19&row=14")["words"]
    assert f"hits {node.shape}, incidence {np.degrees(node.theta_i):.1f}°" in words and "reflected" in words


def test_a_derivative_ends_when_the_page_no_longer_waits(studio, monkeypatch):
    # The picture is made in strips; whoever closed the connection is noticed before the next.
    entered, strips = threading.Event(), []

    def strip(scene, names, settings):
        strips.append(settings.crop)
        entered.set()
        time.sleep(0.3)
        values = np.zeros((len(names), 3, settings.crop[3], settings.crop[2]))
        return PictureDerivatives(values[0], tuple(names), values, ("",) * len(names))

    monkeypatch.setattr("raytrace_jax.report.live.picture_derivatives", strip)
    monkeypatch.setattr(studio, "settings", dataclasses.replace(SETTINGS, size=(4000, 30)))
    with make_server(studio, "a") as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        client = socket.create_connection(("127.0.0.1", server.server_port))
        client.sendall(b"GET /derivative?by=vitreous.ior HTTP/1.0\r\n\r\n")
        assert entered.wait(20)
        # Meanwhile what is quick is answered.
        monkeypatch.setattr(studio, "picture", lambda scene, edges: Image.new("RGB", (1, 1)))
        assert told(studio, "/picture")["image"]
        client.close()
        with studio.locks["derivative"]:
            assert 1 <= len(strips) <= 3 < 15
        server.shutdown()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("text", ["1.3115", "1.31150000000000011", "2.4", "1"])
def test_the_told_value_is_the_rendered_one(studio, monkeypatch, dtype, text):
    scene = jax.tree.map(
        lambda leaf: jnp.asarray(leaf, dtype) if np.issubdtype(leaf.dtype, np.floating) else leaf, studio.scene
    )
    rendered = []
    monkeypatch.setattr(studio, "scene", scene)
    monkeypatch.setattr(studio, "picture", lambda scene, edges: rendered.append(scene) or Image.new("RGB", (1, 1)))
    reply = told(studio, f"/picture?vitreous.ior={text}")
    (moved,) = rendered
    for name, value in reply["values"].items():
        assert np.asarray(moved[name]).dtype == dtype
        assert dtype(float(value)) == np.asarray(moved[name])
    assert reply["values"]["vitreous.ior"] == str(dtype(text)).removesuffix(".0")


@pytest.mark.parametrize(
    ("start", "stop", "step"),
    [(1, 2.4, 0.001), (0, 1, 0.001), (0, 0.7, 0.0001), (-100, 300, 0.001), (1e-6, 3e-6, 1e-9), (2, 6, 0.001)],
)
def test_steps_are_round_and_fine(start, stop, step):
    assert Slider("a", start, stop).step == step <= min(0.001, (stop - start) / 1000 * (1 + 1e-12))


def test_the_page_knows_what_is_compiled():
    studio = Studio(assignment_scene(), SETTINGS, SLIDERS, "course")

    def page():
        return answer(studio, "a", "/")[0].decode()

    assert "compiled = []" in page()
    with pytest.raises(ParameterError):
        answer(studio, "", "/picture?vitreous.ior=-1")
    assert "compiled = []" in page()
    assert told(studio, "/rays?column=19&row=14")["compiled"] == ["rays"]
    assert told(studio, "/picture")["compiled"] == ["picture", "rays"]
    assert told(studio, "/picture?vitreous.ior=2")["compiled"] == ["picture", "rays"]
    assert 'compiled = ["picture", "rays"]' in page()


def test_the_scale_is_that_of_the_sheets():
    mean = np.random.default_rng(1).standard_cauchy((30, 40))
    mean[:10] = 0
    scale = scale_of(mean)
    ticks, limit = scale["ticks"], scale["limit"]
    assert limit == scale_limit(mean[None]) and scale["beyond"] == np.mean(np.abs(mean[10:]) > limit) > 0
    assert len(ticks) >= 3 and 0 in ticks and np.abs(ticks).max() <= limit
    np.testing.assert_allclose(ticks, -np.array(ticks[::-1]), atol=1e-12)
    assert scale_of(np.zeros((3, 4))) | {"ticks": []} == {"limit": 1.0, "ticks": [], "beyond": 0.0}


@pytest.mark.slow
@pytest.mark.parametrize("edges", ["aware", "point"])
def test_derivatives_are_those_of_grad(studio, monkeypatch, edges):
    # Of areas unless points are asked for: `grad` takes the same settings.
    assert studio.edges == "aware"
    monkeypatch.setattr(studio, "edges", edges)
    settings = dataclasses.replace(SETTINGS, edges=edges)
    expected = picture_derivatives(assignment_scene(), ["vitreous.center.x"], settings).values[0]
    reply = told(studio, "/derivative?by=vitreous.center.x")
    scale, mean = reply["scale"], np.asarray(expected).mean(axis=0)
    np.testing.assert_allclose(scale["limit"], scale_limit(np.asarray(expected)), rtol=1e-6)
    assert scale["unit"] == "world unit" and 0 < scale["beyond"] <= 0.01 and 0 in scale["ticks"]
    assert "derivative" in reply["compiled"]
    drawn = np.moveaxis(signed_pixels(mean, scale["limit"]), -1, 0)
    np.testing.assert_allclose(pixels(reply)[INSIDE].astype(int), drawn[INSIDE].astype(int), atol=1)
    assert np.sum(np.abs(mean) > 0.2 * np.percentile(np.abs(mean), 99.5)) > 10


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/picture?vitreous.ior=-1", "greater than 0"),
        ("/picture?vitreous.ior=much", "vitreous.ior is 'much'"),
        ("/picture?vitreous.ior=nan", "vitreous.ior"),
        ("/derivative?by=cyan.alpha", "there are vitreous.ior, vitreous.center.x"),
        ("/rays?row=3", "column is None"),
    ],
)
def test_what_cannot_be_is_refused(studio, path, words):
    with pytest.raises(ParameterError, match=words):
        answer(studio, "", path)


def test_the_server_answers_and_says_errors(studio, monkeypatch, capsys):
    def fail(*_):
        raise MemoryError

    monkeypatch.setattr(studio, "rays", fail)
    with make_server(studio, "a <scene>") as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}"
        with urllib.request.urlopen(address) as reply:
            page = reply.read().decode()
        assert "a &lt;scene&gt;" in page and page.count('type="range"') == 2
        for path, code, words in (
            ("/other", 404, "no such page"),
            ("/picture?vitreous.ior=0", 400, "greater than 0"),
            ("/rays?column=1&row=1", 500, "out of memory"),
        ):
            with pytest.raises(urllib.error.HTTPError) as caught:
                urllib.request.urlopen(address + path)
            assert caught.value.code == code and words in caught.value.read().decode()
        server.shutdown()
    assert "MemoryError" in capsys.readouterr().err
    assert "https://" not in render_page(studio, "a") and "http://" not in render_page(studio, "a")


HAND = """<script>
// All that the page says while it waits.
const said = new Set();
for (const place of document.querySelectorAll(".status")) {
  const note = () => said.add(place.id + " " + place.textContent.split(" ")[0]);
  note();
  new MutationObserver(note).observe(place, { childList: true });
}
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
  seen.old = byId("shown").classList.contains("old");
  await rest();
  seen.new = !byId("shown").classList.contains("old");
  seen.label = inputs[0].parentElement.querySelector("output").textContent;
  seen.after = await look(picture);
  by.value = inputs[0].dataset.name;
  by.dispatchEvent(new Event("change"));
  await rest();
  seen.derivative = await look(byId("derivative"));
  seen.ticks = [...byId("ticks").children].map(tick => tick.textContent);
  seen.meaning = byId("meaning").textContent;
  const place = name => { const b = byId(name).getBoundingClientRect(); return [b.left, b.top, b.right]; };
  seen.boxes = [place("picture"), place("derivative")];
  seen.sliders = document.querySelector(".sliders").getBoundingClientRect().right;
  seen.ends = [...document.querySelectorAll(".ends")].map(ends => [...ends.children].map(end => end.textContent));
  inputs[0].min = -1;
  inputs[0].value = -1;
  inputs[0].dispatchEvent(new Event("input"));
  await rest();
  seen.refused = byId("error").textContent;
  inputs[0].value = 1.8;
  inputs[0].dispatchEvent(new Event("input"));
  await rest();
  const middle = { clientX: box.left + box.width / 2, clientY: box.top + box.height / 2 };
  picture.dispatchEvent(new MouseEvent("click", middle));
  await rest();
  await byId("tree").decode();
  const mark = byId("mark").getBoundingClientRect();
  seen.mark = [mark.left + mark.width / 2 - middle.clientX, mark.top + mark.height / 2 - middle.clientY];
  seen.hit = byId("hit").textContent;
  Object.assign(seen, { rays: byId("tree").naturalWidth, value: inputs[0].value, error: byId("error").textContent });
  seen.said = [...said];
  fetch("/seen", { method: "POST", body: JSON.stringify(seen) });
});
</script>"""


@pytest.mark.slow
def test_sliders_move_picture_and_rays(studio, browser, monkeypatch, tmp_path):
    monkeypatch.setattr(studio, "compiled", set())
    page = render_page(studio, "a scene").replace("</body>", f"{HAND}</body>")
    monkeypatch.setattr("raytrace_jax.report.live.render_page", lambda *_: page)
    seen = {}

    def hear(request):
        seen.update(json.loads(request.rfile.read(int(request.headers["Content-Length"]))))
        request.send_response(204)
        request.end_headers()

    with make_server(studio, "a scene") as server:
        monkeypatch.setattr(server.RequestHandlerClass, "do_POST", hear, raising=False)
        options = [*HEADLESS, "--window-size=1280,800", f"--user-data-dir={tmp_path / 'profile'}"]
        command = [browser, *options, f"http://127.0.0.1:{server.server_port}/"]
        last = time.monotonic() + 300
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
            while not seen and process.poll() is None and time.monotonic() < last:
                time.sleep(0.2)
            process.terminate()
        server.shutdown()
    assert seen, "the page said nothing"
    (before, after, derivative) = (
        np.reshape(seen[name], (30, 40, 4))[..., :3].transpose(2, 0, 1) for name in ("before", "after", "derivative")
    )
    moved = set_parameters(assignment_scene(), {"vitreous.ior": float(seen["value"])})
    for scene, picture in ((assignment_scene(), before), (moved, after)):
        # At rest the picture is that of areas.
        expected = encode_course(np.asarray(render(scene, dataclasses.replace(SETTINGS, edges="aware")).image))
        # A browser goes through the screen's profile, which rounds.
        np.testing.assert_allclose(picture[INSIDE], expected[INSIDE].astype(int), atol=1)
    assert np.any(before != after) and len(np.unique(derivative)) > 20
    # The pixel is marked, and what its ray hits is said.
    assert np.abs(seen["mark"]).max() < 20 and "hits vitreous, incidence" in seen["hit"]
    assert seen["rays"] > 100 and not seen["error"]
    assert seen["old"] and seen["new"] and seen["label"] == seen["value"] == "1.8"
    assert "0" in seen["ticks"] and len(seen["ticks"]) >= 3 and "per unit of index" in seen["meaning"]
    assert "greater than 0" in seen["refused"]
    # Beside the sliders the picture, and beside it the derivative, all of it on the page.
    picture_box, derivative_box = seen["boxes"]
    assert seen["sliders"] <= picture_box[0] and picture_box[2] <= derivative_box[0] <= derivative_box[2] <= 1280
    assert picture_box[1] == derivative_box[1] and seen["ends"] == [["1", "2.4"], ["2", "6"]]
    assert {f"{kind}-status compiling" for kind in ("picture", "derivative", "rays")} <= set(seen["said"])


TOUR = """<script>
addEventListener("load", async () => {
  const rest = async () => { do await new Promise(go => setTimeout(go, 20)); while (!saved || busy || wanted); };
  const seen = [], note = async () => {
    await rest();
    await Promise.all([byId("picture").decode(), byId("tree").decode()]);
    seen.push([byId("picture").src.length, byId("tree").naturalWidth, byId("hit").textContent, values["vitreous.ior"],
      byId("error").textContent]);
  };
  await note();
  for (const input of [inputs[0], byId("pixel")]) {
    input.value = input.max;
    input.dispatchEvent(new Event("input"));
    await note();
  }
  document.body.textContent = `SEEN${JSON.stringify(seen)}NEES`;
});
</script>"""


def test_a_saved_page_needs_no_server(studio, browser, monkeypatch, tmp_path):
    monkeypatch.setattr(studio, "sliders", SLIDERS[:1])
    monkeypatch.setattr(studio, "edges", "point")
    page = saved_page(studio, "a scene", 3)
    assert "http://" not in page.replace("http://www.w3.org", "") and "https://" not in page
    path = tmp_path / "page.html"
    path.write_text(page.replace("</body>", f"{TOUR}</body>"), encoding="utf-8")
    # Virtual time runs as fast as its timers ask, while pictures are unpacked in real time.
    options = [*HEADLESS, "--virtual-time-budget=2000000", "--dump-dom", f"--user-data-dir={tmp_path / 'profile'}"]
    done = subprocess.run([browser, *options, path.as_uri()], capture_output=True, text=True, timeout=120)
    first, moved, rim = json.loads(html.unescape(done.stdout.split("SEEN")[1].split("NEES")[0]))
    assert all(width > 100 and "hits vitreous" in hit and not error for _, width, hit, _, error in (first, moved, rim))
    # The scene's own value is among the three, and the last is the slider's end.
    assert float(first[3]) == pytest.approx(float(studio.values(studio.scene)["vitreous.ior"])) and moved[3] == "2.4"
    assert first[0] != moved[0] and moved[0] == rim[0]

    def incidence(hit):
        return float(hit.split("incidence ")[1].split("°")[0])

    # The picture moves with the index alone; the incidence with the pixel alone, towards grazing.
    assert incidence(first[2]) == incidence(moved[2]) < incidence(rim[2]) > 50
    refracted = [hit.split("refracted to ")[1].split("°")[0] for _, _, hit, *_ in (first, moved)]
    assert float(refracted[0]) > float(refracted[1])
