// Reads arrays of numpy (.npz) as the service writes them: a ZIP archive whose members are stored without compression.

const LOCAL_FILE = 0x04034b50;
const CENTRAL_FILE = 0x02014b50;
/** The types of numbers that views have. */
const KINDS = { '|u1': Uint8Array, '<f4': Float32Array };

/** The arrays of an archive by name: `shape`, and `values` row by row. */
export function readArrays(buffer) {
  const view = new DataView(buffer);
  const arrays = {};
  for (const { name, from, size } of members(view)) {
    arrays[name.replace(/\.npy$/, '')] = readArray(buffer.slice(from, from + size));
  }
  return arrays;
}

/** Name, start and size of each member, from the archive's directory at its end. */
function members(view) {
  const end = view.byteLength - 22;
  const found = [];
  let at = view.getUint32(end + 16, true);
  for (let left = view.getUint16(end + 10, true); left > 0; left--) {
    if (view.getUint32(at, true) !== CENTRAL_FILE) throw new Error('the directory of the arrays is damaged');
    const [nameLength, extraLength, commentLength] = [28, 30, 32].map((offset) => view.getUint16(at + offset, true));
    const local = view.getUint32(at + 42, true);
    if (view.getUint32(local, true) !== LOCAL_FILE) throw new Error('an array is damaged');
    const from = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    found.push({ name: text(view.buffer, at + 46, nameLength), from, size: view.getUint32(at + 24, true) });
    at += 46 + nameLength + extraLength + commentLength;
  }
  return found;
}

function readArray(buffer) {
  const length = new DataView(buffer).getUint16(8, true);
  const header = text(buffer, 10, length);
  const kind = KINDS[/'descr': '([^']+)'/.exec(header)[1]];
  const shape = /'shape': \(([^)]*)\)/.exec(header)[1].split(',').filter((side) => side.trim()).map(Number);
  return { shape, values: new kind(buffer.slice(10 + length)) };
}

function text(buffer, from, length) {
  return new TextDecoder('latin1').decode(new Uint8Array(buffer, from, length));
}
