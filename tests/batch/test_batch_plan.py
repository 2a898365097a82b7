"""Plans of batches: what is refused and where the message points, which jobs there are, and what names a job."""

import dataclasses
import re

import jax
import numpy as np
import pytest
from scenes import DATA

from raytrace_jax import format_scene, load_scene, write_png
from raytrace_jax.batch.jobs import Job, expand, file_name, job_cells, job_scene
from raytrace_jax.batch.plan import read_plan
from raytrace_jax.batch.plan_file import PlanError
from raytrace_jax.tracer.settings import ResolvedSettings

HEAD = 'scenes = ["ball.txt"]\n'


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "ball.txt").write_text((DATA / "vitreous.txt").read_text())
    (tmp_path / "two.txt").write_text((DATA / "two_views.txt").read_text())
    (tmp_path / "broken.txt").write_text("camera {")
    return tmp_path


def jobs_of(folder, text):
    (folder / "plan.toml").write_text(text)
    return expand(read_plan(folder / "plan.toml"))


BAD = [
    ("scenes = [}", ["is not TOML", "line 1"]),
    ("[render]", ["needs scenes: file names", '["vitreous.txt"]']),
    (HEAD, ["says nothing to do", "[gradient]"]),
    (HEAD + "[rendr]", ["rendr", "Did you mean 'render'?", "grid"]),
    (HEAD + "[render]\nsize = [4, 3]", ["render.size", "There are none."]),
    ('scenes = ["bal.txt"]\n[render]', ["bal.txt: there is no such file"]),
    ('scenes = [\n  "ball.txt",\n  "broken.txt"\n]\n[render]', ["broken.txt:1:8"]),
    ('scenes = ["ball.txt", "ball.txt"]\n[render]', ["twice"]),
    ("precision = 16\n" + HEAD + "[render]", ["precision: is 16", "32, 64"]),
    (HEAD + "[render]\n[settings]\n\n# small\nsampels = 2", ["settings.sampels", "'samples'?"]),
    (HEAD + "[render]\n[settings]\nsamples = 0", ["settings.samples: is 0", "1 to 64"]),
    (HEAD + "[render]\n[settings]\nreflection = 1", ["is 1; wanted true or false"]),
    (HEAD + "[render]\n[settings]\nsize = [16, 12]\ncrop = [10, 0, 10, 12]", ["settings.crop", "16 x 12", "ball.txt"]),
    (HEAD + '[render]\n[set]\n"vitreus.ior" = 1.5', ['set."vitreus.ior"', "'vitreous'?", "in ball.txt"]),
    (HEAD + '[render]\n[set]\n"vitreous.ior" = "1.5"', ["is '1.5'; a finite number"]),
    (HEAD + '[render]\n[set]\n"vitreous.ior" = nan', ["is nan; a finite number"]),
    (HEAD + '[render]\n[grid]\n"vitreous.ior" = [\n 1.5,\n -1,\n]', ["greater than 0"]),
    (HEAD + '[render]\n[grid]\n"vitreous.ior" = []', ["an array of values is wanted"]),
    (HEAD + '[render]\n[grid]\n"vitreous.center" = [1, 2, 3]', ["takes 3 numbers, got"]),
    (HEAD + '[render]\n[grid]\n"vitreous.ior" = {start = 1, stop = 2}', ["needs count: a whole number"]),
    (HEAD + '[render]\n[grid]\n"vitreous.ior" = {start = 1, stop = 2, step = 1}', ["step", "'stop'?"]),
    (HEAD + '[render]\n[grid]\nvitreous.ior = [1.5]\n"vitreous.ior" = [1]', ["is given twice"]),
    (HEAD + '[render]\n[set]\n"cyan.ior" = 1.5\n[grid]\n"vitreous.ior" = [1.5]', ["both give the number"]),
    (HEAD + '[render]\n[list]\n"cyan.ior" = [1.5]\n"cyan.alpha" = [0.1, 0.2]', ["has 2 values; 1 are wanted"]),
    (HEAD + '[fit]\nfree = ["cyan.ior"]\nseeds = [1, 1.5]', ["whole numbers from 0 up"]),
    (HEAD + '[fit]\nfree = ["cyan.ior"]\ncorrelations = 3', ["correlations"]),
    (HEAD + '[fit]\nfree = ["cyan.ior"]\ntargets = ["none.exr"]', ["none.exr: there is no such file"]),
    (HEAD + '[fit]\nfree = ["cyan.ior"]\n[fit.start]\n"cyan.ior" = 0', ['fit.start."cyan.ior"', "greater than 0"]),
    (HEAD + '[fit]\nfree = ["cyan.ior"]\n[fit.ties]\n"cyan.alfa" = "cyan.ior"', ["'alpha'?"]),
    (HEAD + '[fit]\nfree = ["cyan.ior"]\n[fit.priors]\n"cyan.ior" = [1.3, 0]', ["fit.priors: is {'cyan.ior': [1.3,"]),
]

TWO = 'scenes = ["two.txt"]\n[fit]\nfree = ["glass.ior"]\n'
BAD += [
    (TWO + 'targets = ["a.png"]', ["fit.targets: ", "cameras left, right: a picture of each", "(in two.txt)"]),
    (TWO + 'targets = [{left = "a.png"}]', ["fit.targets: ", "no picture of the camera right"]),
    (TWO + 'targets = [{left = "a.png", rihgt = "b.png"}]', ["a picture of 'rihgt'", "Did you mean 'right'?"]),
    (TWO + 'targets = [{left = "a.png", right = "b.png"}]', ["fit.targets: ", "a.png: there is no such file"]),
    (TWO + 'targets = [{left = 1, right = "b.png"}]', ["an array of file names, or of tables, { left ="]),
    (HEAD + '[fit]\nfree = ["cyan.ior"]\ntargets = [{left = "a.png"}]', ["a picture of 'left'", "(in ball.txt)"]),
]


@pytest.mark.parametrize(("text", "words"), BAD)
def test_a_bad_plan_is_refused_with_its_key(text, words, folder):
    with pytest.raises(PlanError) as caught:
        jobs_of(folder, text)
    message = str(caught.value)
    assert message.startswith(f"{folder / 'plan.toml'}: ") and "\n" not in message
    for word in words:
        assert word in message


def test_the_documented_plans_are_valid(folder):
    text = (DATA.parent / "docs" / "batch.md").read_text()
    first, second = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    (folder / "vitreous.txt").write_text((DATA / "vitreous.txt").read_text())
    jobs = jobs_of(folder, first)
    assert [sum(job.kind == kind for job in jobs) for kind in ("render", "gradient")] == [12, 12]
    assert len(jobs_of(folder, second)) == 21
    (folder / "plan.toml").write_text(first.replace("vitreous.ior = {", "vitreous.iorr = {"))
    with pytest.raises(PlanError) as caught:
        read_plan(folder / "plan.toml")
    quoted = " ".join(re.search(r"`plan.toml: (.*?) \.\.\.`", text, re.DOTALL)[1].split())
    assert str(caught.value).split("plan.toml: ")[1].startswith(quoted)


def test_grids_are_crossed_and_lists_zipped(folder):
    text = (
        HEAD
        + """
        settings = { size = [16, 12] }
        set = { "cyan.alpha" = 0.5 }
        [list]
        vitreous.center.x = [4, 5]
        "vitreous.center.y" = [1, 2]
        [grid]
        vitreous.ior = { start = 1.0, stop = 2.0, count = 3 }
        "red.diffuse" = [[0, 0, 1], [1, 0, 0]]
        [render]
        [gradient]
        wrt = ["vitreous.ior"]
        """
    )
    jobs = jobs_of(folder, text)
    assert [job.kind for job in jobs] == ["render"] * 12 + ["gradient"] * 12
    values = {"cyan.alpha": 0.5, "vitreous.center.x": 4.0, "vitreous.center.y": 1.0, "vitreous.ior": 1.0}
    assert jobs[1].values == {**values, "red.diffuse": (1.0, 0.0, 0.0)}
    assert [job.values["vitreous.ior"] for job in jobs[:6]] == [1, 1, 1.5, 1.5, 2, 2]
    assert [job.values["vitreous.center.y"] for job in jobs[:12]] == [1] * 6 + [2] * 6
    assert jobs[0].settings == ResolvedSettings(size=(16, 12))
    assert jobs[12].settings == ResolvedSettings(size=(16, 12), edges="aware")


def test_fits_cover_targets_noise_and_seeds(folder):
    for name in ("one.png", "two.png"):
        write_png(folder / name, jax.numpy.ones((3, 4, 5)))
    text = HEAD + '[fit]\nfree = ["cyan.ior"]\nnoise = [0, 0.1]\nseeds = [1, 2]\n'
    noises = [(job.options["noise"], job.options["seed"]) for job in jobs_of(folder, text)]
    assert noises == [(0.0, None), (0.1, 1), (0.1, 2)]
    jobs = jobs_of(folder, text + 'targets = ["one.png", "two.png"]')
    assert [job.options["target_name"] for job in jobs] == ["one.png"] * 3 + ["two.png"] * 3
    assert [job.target for job in jobs] == [str(folder / "one.png")] * 3 + [str(folder / "two.png")] * 3


def test_a_target_of_two_views_is_known_by_all_its_files(folder):
    def job(left, right, targets='{right = "right.png", left = "left.png"}'):
        for name, grey in (("left.png", left), ("right.png", right)):
            write_png(folder / name, jax.numpy.full((3, 4, 5), grey))
        [job] = jobs_of(folder, f"{TWO}targets = [{targets}]")
        return job

    first = job(0.5, 0.6)
    assert first.target == {name: str(folder / f"{name}.png") for name in ("left", "right")}
    assert job_cells(first)["target"] == "right.png+left.png"
    assert file_name(first) == f"two_{first.name[:8]}"
    assert job(0.5, 0.6).name == first.name and len({first.name, job(0.6, 0.5).name, job(0.5, 0.5).name}) == 3


def test_the_scene_file_fills_in_the_plan(folder):
    """Its settings, and what lies on its shapes; the plan's own settings come first."""
    write_png(folder / "board.png", np.full((3, 2, 2), 0.5))
    lab = "settings main { model physical max_bounces 3 samples 2 } camera eye { pixeldim 8 6 viewpoint 0 0 5 "
    lab += "lookat 0 0 0 fov 40 } texture picture { kind image file board.png } material board { emission 1 1 1 "
    lab += "texture picture } rectangle wall { material board center 0 0 0 right 2 0 0 up 0 2 0 }"
    (folder / "lab.txt").write_text(lab)
    text = 'scenes = ["lab.txt"]\n[render]\n[settings]\nsamples = 1\nmapping = "corner"'
    [job] = jobs_of(folder, text)
    assert job.settings == ResolvedSettings(model="physical", max_bounces=3, mapping="corner")
    assert np.asarray(job_scene(job).images.texels[0]).shape == (3, 2, 2)
    write_png(folder / "board.png", np.full((3, 2, 2), 0.25))
    [other] = jobs_of(folder, text)
    assert other.name != job.name
    words = r"least_weight is 0\.001, which has .*only in the physical model.*of ball\.txt"
    with pytest.raises(PlanError, match=words):
        jobs_of(folder, HEAD + "[render]\n[settings]\nleast_weight = 1e-3")


def test_a_jobs_inputs_determine_its_name(folder):
    text = HEAD + '[set]\n"cyan.ior" = 2\n[render]\n'
    [job] = jobs_of(folder, text)
    changes = {
        "kind": "gradient",
        "scene": job.scene._replace(text=job.scene.text + " "),
        "values": {"cyan.ior": 1.5},
        "settings": ResolvedSettings(samples=2),
        "precision": 32,
        "options": {"wrt": ["cyan.ior"]},
    }
    names = {dataclasses.replace(job, **{field: value}).name for field, value in changes.items()}
    assert len(names | {job.name}) == 1 + len(changes)
    fields = {field.name for field in dataclasses.fields(Job)}
    assert fields - set(changes) == {"scene_name", "target", "varied"}
    others = [job.scene._replace(**{name: "other"}) for name in ("folder", "pictures")]
    assert [dataclasses.replace(job, scene=other).name == job.name for other in others] == [True, False]

    # The same numbers written otherwise, in a file of another name, are the same job.
    (folder / "other.txt").write_text(format_scene(load_scene(folder / "ball.txt")))
    [same] = jobs_of(folder, text.replace("ball", "other").replace("= 2", "= 2.0"))
    assert same.name == job.name
    # A target is known by its contents.
    text = HEAD + '[fit]\nfree = ["cyan.ior"]\ntargets = ["target.png"]\n'
    names = []
    for grey in (0.5, 0.6, 0.5):
        write_png(folder / "target.png", jax.numpy.full((3, 4, 5), grey))
        [job] = jobs_of(folder, text)
        names.append(job.name)
    assert names[0] == names[2] != names[1]
