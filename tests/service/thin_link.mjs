// The page's pictures on a thin link: its own modules, with a document of a few elements. Prints what was asked for, as JSON.
// Arguments: address of the service, folder of the page's modules.

const [address, folder] = process.argv.slice(2);
const PATIENCE_MS = 60_000;

const element = () => ({
  dataset: {}, style: {}, classList: { toggle() {} }, hidden: false, textContent: '',
  querySelector: element, getContext: () => ({ drawImage() {} }),
});
globalThis.document = { getElementById: element };
globalThis.sessionStorage = { getItem: () => null };
globalThis.ImageData = class {};
globalThis.createImageBitmap = async () => ({ width: 1, height: 1 });

const asked = [];
let [underWay, mostAtOnce] = [0, 0];
const fetchFrom = globalThis.fetch;
globalThis.fetch = async (path, options) => {
  asked.push(Number(/width=(\d+)/.exec(path)[1]));
  mostAtOnce = Math.max(mostAtOnce, ++underWay);
  const answer = await fetchFrom(`http://${address}${path}`, options);
  const take = answer.arrayBuffer.bind(answer);
  answer.arrayBuffer = () => take().finally(() => (underWay -= 1));
  return answer;
};

const { ViewLoop } = await import(`${folder}/views.js`);
const { Link } = await import(`${folder}/link.js`);
const state = { pose: { x: 0.22, y: 0.2, z: 0.5, yaw: 11, pitch: 20, roll: 0 }, lens: '', size: 640 };
const drawn = { exact: 0, nearest: 0 };
const tab = { isActive: () => true, drawn: (method) => (drawn[method] += 1), refused() {} };
const link = new Link();
const loops = ['exact', 'nearest'].map((method) => new ViewLoop(method, element(), state, tab, link));

const began = Date.now();
while (Date.now() - began < PATIENCE_MS && !(drawn.exact > 2 && drawn.nearest > 2)) {
  state.pose = { ...state.pose, yaw: state.pose.yaw + 0.1 };
  loops.forEach((loop) => loop.want());
  await new Promise((resolve) => setTimeout(resolve, 50));
}
console.log(JSON.stringify({ asked, mostAtOnce, drawn }));
process.exit(0);
