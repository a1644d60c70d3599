// What a browser program does with roslibjs, step by step; prints one JSON object: step -> what came back.
// Usage: node roslib_scenario.mjs roslib1|roslib2 ws://HOST:PORT

const [library, url] = process.argv.slice(2);
const imported = await import(library);
const ROSLIB = imported.default ?? imported;

// Every wait ends: a step that hears nothing fails by name.
const STEP_TIMEOUT_MS = 120_000;

const answers = {};

function within(name, promise) {
  return Promise.race([
    promise,
    new Promise((_, reject) => setTimeout(() => reject(new Error(`${name}: no answer`)), STEP_TIMEOUT_MS).unref()),
  ]);
}

async function step(name, start) {
  answers[name] = await within(name, new Promise(start));
}

function connect() {
  return within(
    "connect",
    new Promise((resolve, reject) => {
      const ros = new ROSLIB.Ros({ url });
      ros.on("connection", () => resolve(ros));
      ros.on("error", reject);
    }),
  );
}

const message = (values) => (ROSLIB.Message ? new ROSLIB.Message(values) : values);
const request = (values) => (ROSLIB.ServiceRequest ? new ROSLIB.ServiceRequest(values) : values);

const ros = await connect();
const other = await connect();

await step("topics", (resolve, reject) => ros.getTopics(resolve, reject));
await step("services", (resolve, reject) => ros.getServices(resolve, reject));
await step("topic type", (resolve, reject) => ros.getTopicType("/joint_states", resolve, reject));
await step("message details", (resolve, reject) => ros.getMessageDetails("sensor_msgs/JointState", resolve, reject));

await step("joint states", (resolve) => {
  const topic = new ROSLIB.Topic({ ros, name: "/joint_states", messageType: "sensor_msgs/JointState" });
  topic.subscribe((state) => {
    topic.unsubscribe();
    resolve(state);
  });
});

for (const compression of ["png", "cbor"]) {
  await step(`joint states as ${compression}`, (resolve) => {
    const topic = new ROSLIB.Topic({ ros, name: "/joint_states", messageType: "sensor_msgs/JointState", compression });
    topic.subscribe((state) => {
      topic.unsubscribe();
      resolve({ name: state.name, position: Array.from(state.position) });
    });
  });
}

await step("relayed", (resolve) => {
  const listener = new ROSLIB.Topic({ ros: other, name: "/chatter", messageType: "std_msgs/String" });
  const talker = new ROSLIB.Topic({ ros, name: "/chatter", messageType: "std_msgs/String" });
  let timer = null;
  listener.subscribe((heard) => {
    clearInterval(timer);
    resolve(heard.data);
  });
  talker.advertise();
  timer = setInterval(() => talker.publish(message({ data: "hello" })), 50);
});

await step("goal", (resolve) => {
  const result = new ROSLIB.Topic({ ros, name: "/moveit_goal_result", messageType: "moveit_msgs/MoveItErrorCodes" });
  result.subscribe((answer) => {
    result.unsubscribe();
    resolve(answer);
  });
  const goal = new ROSLIB.Topic({ ros, name: "/moveit_goal_named", messageType: "std_msgs/String" });
  goal.publish(message({ data: "ready" }));
});

const offered = new ROSLIB.Service({ ros, name: "/switch", serviceType: "std_srvs/SetBool" });
offered.advertise((asked, response) => {
  response.success = asked.data;
  response.message = asked.data ? "on" : "off";
  return true;
});
await step("offered service", (resolve, reject) => {
  const call = () =>
    new ROSLIB.Service({ ros: other, name: "/switch", serviceType: "std_srvs/SetBool" }).callService(
      request({ data: true }),
      resolve,
      // The two connections are not ordered against each other: the offer may not have been read yet.
      (error) => (String(error).includes("does not exist") ? setTimeout(call, 50) : reject(error)),
    );
  call();
});

await step("unknown service", (resolve, reject) => {
  new ROSLIB.Service({ ros, name: "/nobody", serviceType: "std_srvs/Trigger" }).callService(request({}), reject, resolve);
});

await step("parameter", (resolve) => {
  const parameter = new ROSLIB.Param({ ros, name: "speed" });
  parameter.set(0.5, () => parameter.get(resolve));
});

await step("unknown parameter", (resolve) => {
  // Version 1 gets what stands for no value, version 2 the reason.
  const parameter = new ROSLIB.Param({ ros, name: "nobody_has_set_this" });
  parameter.get((value) => resolve(value || null), (reason) => resolve(`failed: ${reason}`));
});

function fibonacci(order) {
  const sequence = [0, 1];
  while (sequence.length <= order) {
    sequence.push(sequence.at(-1) + sequence.at(-2));
  }
  return sequence;
}

if (ROSLIB.Action) {
  const series = { name: "/fibonacci", actionType: "example_interfaces/action/Fibonacci" };
  const teacher = new ROSLIB.Action({ ros: other, ...series });
  teacher.advertise(
    (goal, id) => {
      teacher.sendFeedback(id, { sequence: fibonacci(2) });
      teacher.setSucceeded(id, { sequence: fibonacci(goal.order) });
    },
    () => {},
  );
  await step("fibonacci", (resolve, reject) => {
    let feedback = null;
    const send = () =>
      new ROSLIB.Action({ ros, ...series }).sendGoal(
        { order: 7 },
        (result) => resolve({ result, feedback }),
        (told) => (feedback = told),
        (error) => (String(error).includes("does not exist") ? setTimeout(send, 50) : reject(new Error(error))),
      );
    send();
  });
} else {
  // roslibjs 1 knows the five topics of actionlib only.
  const series = { serverName: "/fibonacci", actionName: "actionlib_tutorials/FibonacciAction" };
  const teacher = new ROSLIB.SimpleActionServer({ ros: other, ...series });
  teacher.on("goal", (goal) => {
    teacher.sendFeedback({ sequence: fibonacci(2) });
    teacher.setSucceeded({ sequence: fibonacci(goal.order) });
  });
  await step("fibonacci", (resolve) => {
    let feedback = null;
    const client = new ROSLIB.ActionClient({ ros, ...series });
    const goal = new ROSLIB.Goal({ actionClient: client, goalMessage: { order: 7 } });
    goal.on("feedback", (told) => (feedback = told));
    goal.on("result", (result) => resolve({ result, feedback }));
    setTimeout(() => goal.send(), 300);
  });
}

// As ros3djs shows a robot. Each on a connection of its own: the first makes its connection one of ROS 1.
for (const client of ["TFClient", "ROS2TFClient"]) {
  if (!ROSLIB[client]) continue;
  const viewer = await connect();
  await step(client, (resolve) => {
    const transforms = new ROSLIB[client]({ ros: viewer, fixedFrame: "base_link" });
    transforms.subscribe("gripper_link", resolve);
  });
}

await step("URDF of a node", (resolve) => {
  new ROSLIB.Param({ ros, name: "/robot_state_publisher:robot_description" }).get(resolve);
});

console.log(JSON.stringify(answers));
process.exit(0);
