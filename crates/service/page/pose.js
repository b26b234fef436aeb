// The pose of the camera: metres and degrees, x along the field, y to the left, yaw to the left, pitch above 0 looks down.

export const START = { x: 0, y: 0, z: 0.5, yaw: 0, pitch: 15, roll: 0 };
const LIMITS = { x: [-100, 100], y: [-100, 100], z: [0.02, 20], yaw: [-Infinity, Infinity], pitch: [-90, 90], roll: [-180, 180] };
const DECIMALS = { x: 3, y: 3, z: 3, yaw: 2, pitch: 2, roll: 2 };
export const NAMES = Object.keys(START);

/** The same pose within what the service answers. */
export function bounded(pose) {
  const result = {};
  for (const name of NAMES) {
    const [low, high] = LIMITS[name];
    const value = Number(pose[name]);
    result[name] = Number.isFinite(value) ? Math.min(high, Math.max(low, value)) : START[name];
  }
  result.yaw = ((((result.yaw + 180) % 360) + 360) % 360) - 180;
  return result;
}

export function rounded(pose, name) {
  return Number(pose[name].toFixed(DECIMALS[name]));
}

/** The pose as parameters of the address line. */
export function toParameters(pose) {
  return Object.fromEntries(NAMES.filter((name) => name !== 'roll' || pose.roll).map((name) => [name, rounded(pose, name)]));
}

export function fromParameters(parameters) {
  const pose = { ...START };
  for (const name of NAMES) if (parameters.has(name)) pose[name] = Number(parameters.get(name));
  return bounded(pose);
}

/** The pose as parameters of /v1/view. */
export function toQuery(pose) {
  const { x, y, z, yaw, pitch, roll } = Object.fromEntries(NAMES.map((name) => [name, rounded(pose, name)]));
  return { x, y, z, yaw_deg: yaw, pitch_deg: pitch, roll_deg: roll };
}

/** The pose after a step ahead and to the left, metres. */
export function stepped(pose, ahead, left) {
  const yaw = (pose.yaw * Math.PI) / 180;
  const [cos, sin] = [Math.cos(yaw), Math.sin(yaw)];
  return { ...pose, x: pose.x + ahead * cos - left * sin, y: pose.y + ahead * sin + left * cos };
}
