// A whole client of Stampede RT in Node, from proto/ alone: bind, open a channel, subscribe, put, get.
//
//   node client.js PROTO_FOLDER ADDRESS SECRET_FILE CHANNEL TEXT...
//
// Puts each TEXT as one item. Prints the seqs of its puts, the items of the last 30 s and the items of the subscription.
// AS_OF may name an instant, in nanoseconds. The client then prints the items of the 30 s before it, as the host
// of a recorded channel knew them at that instant.
"use strict";

const crypto = require("node:crypto");
const fs = require("node:fs");
const path = require("node:path");
const grpc = require("@grpc/grpc-js");
const loader = require("@grpc/proto-loader");

const [protoFolder, address, secretFile, channelName, ...texts] = process.argv.slice(2);

// Instants have 63 bits, more than a number holds: the loader gives and takes 64-bit fields as strings.
const folder = path.join(protoFolder, "stampede_rt/v1");
const files = fs.readdirSync(folder).filter((name) => name.endsWith(".proto"));
const definition = loader.loadSync(
  files.map((name) => `stampede_rt/v1/${name}`),
  { includeDirs: [protoFolder], keepCase: true, longs: String, enums: String, defaults: true, oneofs: true },
);
const v1 = grpc.loadPackageDefinition(definition).stampede_rt.v1;

const metadata = new grpc.Metadata();
metadata.set("authorization", `Bearer ${fs.readFileSync(secretFile, "utf8").trim()}`);

function connect(Service, target) {
  const options = { "grpc.max_receive_message_length": 20 << 20 }; // one item may have 16 MiB
  return new Service(target, grpc.credentials.createInsecure(), options);
}

function call(client, method, request) {
  return new Promise((resolve, reject) => {
    const done = (error, response) => (error ? reject(error) : resolve(response));
    client[method](request, metadata, { deadline: Date.now() + 10_000 }, done);
  });
}

// The reason that the server gave: one google.rpc.ErrorInfo inside a google.rpc.Status in a trailer.
function explain(error) {
  const [bytes] = error.metadata?.get("grpc-status-details-bin") ?? [];
  if (!bytes) return String(error.message);
  const details = definition["stampede_rt.v1.Status"].deserialize(bytes).details;
  const info = definition["stampede_rt.v1.ErrorInfo"].deserialize(details[0].value);
  return `${info.reason}: ${error.details} ${JSON.stringify(info.metadata)}`;
}

// Each service on the way to the channel: front-end -> supernode -> gatekeeper -> data endpoint.
async function open(name) {
  const bound = await call(connect(v1.FrontendService, address), "Bind", { protocol_version: 1 });
  metadata.set("stampede-cluster-id", bound.cluster_id); // servers of other clusters refuse this client from here on
  const directory = connect(v1.DirectoryService, bound.supernodes[0].endpoint.target); // the best one comes first
  const opened = await call(directory, "OpenChannel", {
    request_id: crypto.randomBytes(16),
    name,
    create: true,
    spec: { retention: { max_age_nanos: "60000000000" } },
  });
  const gatekeeper = connect(v1.GatekeeperService, opened.host.gatekeepers[0].target);
  const { channel_id, epoch } = opened.channel;
  const place = await call(gatekeeper, "BindChannel", { channel_id, epoch });
  // Every request names the channel and the epoch; so they are kept together.
  return { data: connect(v1.ChannelService, place.endpoints[0].target), at: { channel_id, epoch: place.channel.epoch } };
}

// Puts each text as a run of one item. The acks come in order.
async function put({ data, at }, texts) {
  const stream = data.Put(metadata);
  const producer_id = crypto.randomBytes(8).readBigUInt64LE().toString(); // this id and the numbers make retries safe
  texts.forEach((text, index) => {
    const payloads = Buffer.from(text);
    const run = {
      time_unix_nano: [(BigInt(Date.now()) * 1_000_000n).toString()],
      payload_length_bytes: [payloads.length],
      content_type: "text/plain",
      payloads,
    };
    stream.write({ ...at, producer_id, puts: [{ first_number: index + 1, run }] });
  });
  stream.end();
  const seqs = [];
  for await (const response of stream) {
    for (const ack of response.acks) {
      if (ack.error || ack.rejections.length) throw new Error(JSON.stringify(ack));
      seqs.push(Number(ack.first_seq));
    }
  }
  return seqs;
}

// The items whose span shares an instant with the last `seconds`.
async function last({ data, at }, seconds) {
  const start = { meta_time: "META_TIME_NOW", offset_nanos: `-${seconds}000000000` };
  const asOf = process.env.AS_OF && { as_of_unix_nano: process.env.AS_OF };
  const stream = data.Get(metadata);
  stream.end({ ...at, ...asOf, call_id: 1, interval: { start, end: { meta_time: "META_TIME_NOW" } } });
  const items = [];
  for await (const response of stream) {
    if (response.error) throw new Error(`${response.error.reason}: ${response.error.message}`);
    items.push(...unpack(response.runs));
  }
  return items;
}

// Cuts the columns of runs into items.
function unpack(runs) {
  return runs.flatMap(({ run }) => {
    let start = 0;
    return run.payload_length_bytes.map((length, index) => ({
      Time: run.time_unix_nano[index],
      Seq: Number(run.first_seq) + index,
      Text: run.payloads.subarray(start, (start += length)).toString(),
    }));
  });
}

async function main() {
  const channel = await open(channelName);
  const subscription = channel.data.Subscribe(metadata);
  subscription.write({ open: channel.at, credit_bytes: 1 }); // 1: one item
  const responses = subscription[Symbol.asyncIterator]();
  await responses.next(); // has `opened`: from here on the subscription misses no item
  const seqs = await put(channel, texts);
  const subscribed = [];
  while (subscribed.length < texts.length) {
    for (const item of unpack((await responses.next()).value.runs)) {
      subscribed.push(item);
      subscription.write({ credit_bytes: Buffer.byteLength(item.Text) + 64 }); // credit for the next item
    }
  }
  console.log(JSON.stringify({ put: seqs, last: await last(channel, 30), subscribed }));
  process.exit(0); // the subscription would go on
}

main().catch((error) => {
  console.error(explain(error));
  process.exit(1);
});
