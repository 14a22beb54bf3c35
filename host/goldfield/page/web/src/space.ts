// The site in three dimensions. A picture is drawn only when something changed and the view can be seen.

import {
  AmbientLight, BoxGeometry, BufferAttribute, BufferGeometry, CanvasTexture, Color, ConeGeometry, DirectionalLight, EdgesGeometry,
  Group, Line, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial, OctahedronGeometry,
  PerspectiveCamera, Scene, SphereGeometry, Sprite, SRGBColorSpace, SpriteMaterial, TetrahedronGeometry, Vector3, WebGLRenderer,
  type BufferGeometry as Geometry, type Material,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { colour } from "./dom";
import { cholesky, magnification, niceStep, RADIUS_95, rotation, size } from "./geometry";
import type { Shown } from "./plan";
import type { Health, Matrix, Pose, Site, Vector } from "./protocol";
import type { Trail } from "./trail";
import { beaconSaid, type Tone } from "./words";

const MOST_TRAIL = 600;
const FIELD_OF_VIEW = 40;
/** Of more beacons than these only those that something is wrong with are named: names would hide each other. */
const MOST_NAMED = 24;
const VIEWS: Record<string, Vector> = { oblique: [-0.55, -0.9, 0.62], top: [0, -0.001, 1], front: [0, -1, 0.001], side: [1, -0.001, 0.001] };
const AXES = ["axis-x", "axis-y", "axis-z"];

interface BeaconShapes {
  wire: Line;
  marks: Record<Tone, Mesh>;
  name: Sprite;
}

export class Space {
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(FIELD_OF_VIEW, 1, 0.01, 1000);
  private readonly renderer: WebGLRenderer;
  private readonly controls: OrbitControls;
  private readonly siteGroup = new Group();
  private readonly sensor = new Group();
  private readonly axes = new Group();
  private readonly rods = AXES.map(() => new Mesh(new BoxGeometry(1, 1, 1), new MeshBasicMaterial()));
  private readonly letters = new Group();
  private readonly beacons = new Map<string, BeaconShapes>();
  private readonly trail: Line;
  private readonly ellipsoid: Mesh;
  private readonly protection: LineSegments;
  private trailVersion = -1;
  private whole = 1;
  private centre = new Vector3();
  private wanted = false;
  private visible = true;
  private site: Site | null = null;
  private health: Health | null = null;

  constructor(private readonly host: HTMLElement) {
    this.renderer = new WebGLRenderer({ antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
    const canvas = this.renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The site in three dimensions; arrow keys turn it, plus and minus change the distance");
    host.append(canvas);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.draw());
    canvas.addEventListener("keydown", (event) => this.key(event));
    const sun = new DirectionalLight(0xffffff, 2);
    sun.position.set(-1, -2, 4);
    this.scene.add(new AmbientLight(0xffffff, 1.6), sun, this.siteGroup, this.sensor);

    const line = new BufferGeometry();
    line.setAttribute("position", new BufferAttribute(new Float32Array(3 * MOST_TRAIL), 3));
    this.trail = new Line(line, new LineBasicMaterial());
    this.trail.frustumCulled = false;
    this.scene.add(this.trail);
    this.ellipsoid = new Mesh(new SphereGeometry(1, 32, 20), new MeshLambertMaterial({ transparent: true, opacity: 0.45, depthWrite: false }));
    this.ellipsoid.matrixAutoUpdate = false;
    this.protection = new LineSegments(new EdgesGeometry(new SphereGeometry(1, 16, 10), 1), new LineBasicMaterial({ transparent: true, opacity: 0.35 }));
    this.axes.add(...this.rods);
    this.sensor.add(this.axes, this.ellipsoid, this.protection);
    this.sensor.visible = false;

    new ResizeObserver(() => this.resize()).observe(host);
    new IntersectionObserver(([entry]) => {
      this.visible = entry.isIntersecting;
      this.draw();
    }).observe(host);
    this.paint();
  }

  /** Take the colours of the style sheet, again when the page turns dark or light. */
  paint(): void {
    const set = (material: Material | Material[], name: string): void => {
      (material as LineBasicMaterial).color.set(new Color(colour(name)));
    };
    set(this.trail.material, "accent");
    set(this.ellipsoid.material, "accent");
    set(this.protection.material, "ink");
    this.rods.forEach((rod, i) => set(rod.material, AXES[i]));
    if (this.site) this.build(this.site);
    this.draw();
  }

  setSite(site: Site): void {
    this.site = site;
    const { low_m: low, high_m: high } = site.box;
    this.whole = size(low, high);
    this.centre.set(...(low.map((value, i) => (value + high[i]) / 2) as Vector));
    this.sensor.visible = false;
    this.health = null;
    this.trailVersion = -1;
    this.build(site);
    this.look("oblique");
  }

  private build(site: Site): void {
    this.siteGroup.clear();
    this.beacons.clear();
    const { low_m: low, high_m: high } = site.box;
    const box = new LineSegments(new EdgesGeometry(new BoxGeometry(...(low.map((v, i) => high[i] - v) as Vector))), new LineBasicMaterial({ color: colour("rule") }));
    box.position.copy(this.centre);
    this.siteGroup.add(box, this.floor(low, high));
    const s = 0.026 * this.whole;
    const shapes: Record<Tone, Geometry> = {
      good: new SphereGeometry(0.55 * s, 16, 12), warn: new OctahedronGeometry(0.9 * s), bad: new ConeGeometry(0.8 * s, 1.5 * s, 4), idle: new TetrahedronGeometry(0.8 * s),
    };
    for (const beacon of site.beacons) {
      const wire = new Line(new BufferGeometry().setFromPoints(beacon.wire_m.map((p) => new Vector3(...p))), new LineBasicMaterial());
      const marks = {} as Record<Tone, Mesh>;
      for (const tone of Object.keys(shapes) as Tone[]) {
        marks[tone] = new Mesh(shapes[tone], new MeshLambertMaterial({ color: colour(tone) }));
        marks[tone].position.set(...beacon.position_m);
        this.siteGroup.add(marks[tone]);
      }
      const name = this.label(beacon.id, beacon.position_m, 2.2 * s);
      this.siteGroup.add(wire, name);
      this.beacons.set(beacon.id, { wire, marks, name });
    }
    const reach = 0.16 * this.whole;
    this.letters.clear();
    AXES.forEach((axis, i) => this.letters.add(this.label(axis.slice(-1), new Vector3().setComponent(i, reach).toArray(), 0, axis)));
    this.axes.add(this.letters);
    this.setHealth(this.health);
  }

  private floor(low: Vector, high: Vector): LineSegments {
    const step = niceStep(Math.max(high[0] - low[0], high[1] - low[1]), 8);
    const points: Vector3[] = [];
    for (let x = Math.ceil(low[0] / step) * step; x <= high[0]; x += step) points.push(new Vector3(x, low[1], low[2]), new Vector3(x, high[1], low[2]));
    for (let y = Math.ceil(low[1] / step) * step; y <= high[1]; y += step) points.push(new Vector3(low[0], y, low[2]), new Vector3(high[0], y, low[2]));
    return new LineSegments(new BufferGeometry().setFromPoints(points), new LineBasicMaterial({ color: colour("rule"), transparent: true, opacity: 0.5 }));
  }

  private label(text: string, at: Vector, above: number, ink = "ink"): Sprite {
    const canvas = document.createElement("canvas");
    const context = canvas.getContext("2d") as CanvasRenderingContext2D;
    const font = "600 44px system-ui, sans-serif";
    context.font = font;
    canvas.width = Math.ceil(context.measureText(text).width) + 16;
    canvas.height = 60;
    context.font = font;
    context.fillStyle = colour(ink);
    context.textBaseline = "middle";
    context.fillText(text, 8, 30);
    const texture = new CanvasTexture(canvas);
    texture.colorSpace = SRGBColorSpace;
    const sprite = new Sprite(new SpriteMaterial({ map: texture, depthTest: false, transparent: true }));
    const height = 0.06 * this.whole;
    sprite.scale.set((height * canvas.width) / canvas.height, height, 1);
    sprite.position.set(at[0], at[1], at[2] + above);
    return sprite;
  }

  setHealth(health: Health | null): void {
    this.health = health;
    for (const [id, { wire, marks, name }] of this.beacons) {
      const { tone } = beaconSaid(health?.beacons[id]);
      name.visible = this.beacons.size <= MOST_NAMED || tone === "bad" || tone === "warn";
      (wire.material as LineBasicMaterial).color.set(new Color(colour(tone)));
      for (const [which, mark] of Object.entries(marks)) mark.visible = which === tone;
    }
    this.draw();
  }

  /** Draw a pose, and return what a note must say of how it is drawn. */
  setPose(pose: Pose, trail: Trail, shown: Shown): string {
    this.setTrail(trail, shown.trail);
    const at = pose.position_m;
    this.sensor.visible = at !== null;
    this.draw();
    if (!at || !pose.orientation_xyzw) return "";
    this.sensor.position.set(...at);
    this.turnAxes(rotation(pose.orientation_xyzw));
    this.protection.visible = shown.protection && pose.protection_m !== null;
    this.protection.scale.setScalar(pose.protection_m ?? 1);
    const l = shown.covariance && pose.position_cov_m2 ? cholesky(pose.position_cov_m2) : null;
    this.ellipsoid.visible = l !== null;
    if (!l) return "";
    const larger = magnification(RADIUS_95.space * Math.hypot(...l.flat()), this.whole);
    const k = RADIUS_95.space * larger;
    this.ellipsoid.matrix.set(k * l[0][0], 0, 0, 0, k * l[1][0], k * l[1][1], 0, 0, k * l[2][0], k * l[2][1], k * l[2][2], 0, 0, 0, 0, 1);
    return `ellipsoid: 95 % of the covariance${larger > 1 ? `, drawn ${larger} times larger` : ""}`;
  }

  private setTrail(trail: Trail, shown: boolean): void {
    this.trail.visible = shown;
    if (!shown || trail.version === this.trailVersion) return;
    this.trailVersion = trail.version;
    const places = this.trail.geometry.getAttribute("position") as BufferAttribute;
    trail.points.forEach((point, i) => places.setXYZ(i, ...point));
    places.needsUpdate = true;
    this.trail.geometry.setDrawRange(0, trail.points.length);
  }

  private turnAxes(turned: Matrix): void {
    const reach = 0.13 * this.whole;
    const thick = 0.007 * this.whole;
    this.axes.setRotationFromMatrix(new Matrix4().set(...turned[0], 0, ...turned[1], 0, ...turned[2], 0, 0, 0, 0, 1));
    this.rods.forEach((axis, i) => {
      const direction = new Vector3().setComponent(i, 1);
      axis.position.copy(direction).multiplyScalar(reach / 2);
      axis.scale.setScalar(thick).setComponent(i, reach);
    });
  }

  /** Look from one of `VIEWS` at the whole site. */
  look(from: string): void {
    const distance = (0.82 * this.whole) / Math.tan((FIELD_OF_VIEW * Math.PI) / 360) / Math.min(1, this.camera.aspect);
    this.camera.position.copy(this.centre).addScaledVector(new Vector3(...VIEWS[from]).normalize(), distance);
    this.camera.near = distance / 100;
    this.camera.far = distance * 20;
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(this.centre);
    this.controls.update();
    this.draw();
  }

  private key(event: KeyboardEvent): void {
    const turns: Record<string, [number, number]> = { ArrowLeft: [-0.12, 0], ArrowRight: [0.12, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    const nearer: Record<string, number> = { "+": 0.87, "=": 0.87, "-": 1.15 };
    const offset = this.camera.position.clone().sub(this.controls.target);
    if (event.key in turns) {
      const [around, down] = turns[event.key];
      const [r, flat] = [offset.length(), Math.atan2(offset.y, offset.x) + around];
      const polar = Math.min(Math.PI - 0.01, Math.max(0.01, Math.acos(offset.z / r) + down));
      offset.set(r * Math.sin(polar) * Math.cos(flat), r * Math.sin(polar) * Math.sin(flat), r * Math.cos(polar));
    } else if (event.key in nearer) {
      offset.multiplyScalar(nearer[event.key]);
    } else if (event.key === "Home") {
      event.preventDefault();
      this.look("oblique");
      return;
    } else {
      return;
    }
    event.preventDefault();
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.draw();
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (!width || !height) return;
    this.renderer.setSize(width, height);
    const first = this.camera.aspect === 1;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (first && this.site) this.look("oblique");
    this.draw();
  }

  private draw(): void {
    if (this.wanted || !this.visible) return;
    this.wanted = true;
    requestAnimationFrame(() => {
      this.wanted = false;
      this.renderer.render(this.scene, this.camera);
    });
  }
}
