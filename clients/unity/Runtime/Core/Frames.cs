using System;
using System.Collections.Generic;
using System.Globalization;
using Newtonsoft.Json.Linq;

namespace Armbridge
{
    /// <summary>Time that marks one goal; the goal's statuses repeat it as "seconds.nanoseconds".</summary>
    public readonly struct GoalStamp
    {
        private readonly long seconds;
        private readonly int nanoseconds;

        /// <param name="count">number of the goal; keeps two stamps of one millisecond apart.</param>
        public GoalStamp(DateTimeOffset now, int count)
        {
            seconds = now.ToUnixTimeSeconds();
            nanoseconds = now.Millisecond * 1000000 + count % 1000000;
        }

        internal JObject Header(string frame)
        {
            return new JObject(
                new JProperty("stamp", new JObject(new JProperty("sec", seconds), new JProperty("nanosec", nanoseconds))),
                new JProperty("frame_id", frame));
        }

        public override string ToString()
        {
            return seconds.ToString(CultureInfo.InvariantCulture) + "." + nanoseconds.ToString("D9", CultureInfo.InvariantCulture);
        }
    }

    /// <summary>The rosbridge operations that are sent, as JSON. Positions are in ROS's axes [m], angles in radians.</summary>
    public static class Frames
    {
        public const string NamedTopic = "/moveit_goal_named";
        public const string JointsTopic = "/moveit_goal_joints";
        public const string PoseTopic = "/moveit_goal_pose";
        public const string StopTopic = "/stop";
        public const string StatusTopic = "/moveit_goal_status";
        public const string JointStatesTopic = "/joint_states";
        public const string GripperAction = "/gripper_controller/gripper_cmd";

        /// <summary>The operations after connecting: refusals are heard, goals can be published, states and statuses come.</summary>
        public static IEnumerable<string> Setup()
        {
            yield return Compact(new JObject(new JProperty("op", "set_level"), new JProperty("level", "error")));
            yield return Advertise(NamedTopic, "std_msgs/String");
            yield return Advertise(JointsTopic, "sensor_msgs/JointState");
            yield return Advertise(PoseTopic, "geometry_msgs/PoseStamped");
            yield return Advertise(StopTopic, "std_msgs/Empty");
            yield return Subscribe(StatusTopic, "diagnostic_msgs/DiagnosticStatus", 0);
            yield return Subscribe(JointStatesTopic, "sensor_msgs/JointState", 33);
        }

        /// <summary>With a token, this is the first operation of a connection.</summary>
        public static string Authenticate(string token)
        {
            return Compact(new JObject(new JProperty("op", "auth"), new JProperty("token", token)));
        }

        public static string Named(string target)
        {
            return Publish(NamedTopic, new JObject(new JProperty("data", target)));
        }

        public static string Joints(GoalStamp stamp, string[] names, double[] positionsRad)
        {
            if (names.Length != positionsRad.Length)
            {
                throw new ArgumentException("names has " + names.Length + " joints and positionsRad has " + positionsRad.Length);
            }
            return Publish(JointsTopic, new JObject(
                new JProperty("header", stamp.Header("base_link")),
                new JProperty("name", new JArray(names)),
                new JProperty("position", new JArray(Array.ConvertAll(positionsRad, Finite)))));
        }

        /// <param name="rotation">null leaves the orientation to the planner, which five joints cannot choose.</param>
        public static string Pose(GoalStamp stamp, Triple position, Rotation? rotation)
        {
            var pose = new JObject(new JProperty("position", new JObject(
                new JProperty("x", Finite(position.X)), new JProperty("y", Finite(position.Y)), new JProperty("z", Finite(position.Z)))));
            if (rotation is Rotation turned)
            {
                pose.Add("orientation", new JObject(
                    new JProperty("x", Finite(turned.X)), new JProperty("y", Finite(turned.Y)),
                    new JProperty("z", Finite(turned.Z)), new JProperty("w", Finite(turned.W))));
            }
            return Publish(PoseTopic, new JObject(new JProperty("header", stamp.Header("base_link")), new JProperty("pose", pose)));
        }

        /// <param name="id">names the goal in its answer.</param>
        /// <param name="positionRad">of the gripper's joint.</param>
        /// <param name="maxEffort">greatest torque as a share of the servo's, 0 for the server's own.</param>
        public static string Gripper(string id, double positionRad, double maxEffort)
        {
            return Compact(new JObject(
                new JProperty("op", "send_action_goal"), new JProperty("id", id), new JProperty("action", GripperAction),
                new JProperty("action_type", "control_msgs/action/GripperCommand"),
                new JProperty("args", new JObject(new JProperty("command", new JObject(
                    new JProperty("position", Finite(positionRad)), new JProperty("max_effort", Finite(maxEffort))))))));
        }

        public static string Stop()
        {
            return Publish(StopTopic, new JObject());
        }

        private static string Advertise(string topic, string type)
        {
            return Compact(new JObject(new JProperty("op", "advertise"), new JProperty("topic", topic), new JProperty("type", type)));
        }

        private static string Subscribe(string topic, string type, int throttleMs)
        {
            var operation = new JObject(new JProperty("op", "subscribe"), new JProperty("topic", topic), new JProperty("type", type));
            if (throttleMs > 0)
            {
                operation.Add("throttle_rate", throttleMs);
            }
            return Compact(operation);
        }

        private static string Publish(string topic, JObject message)
        {
            return Compact(new JObject(new JProperty("op", "publish"), new JProperty("topic", topic), new JProperty("msg", message)));
        }

        // JSON has no NaN: it would be written as a word that the server refuses to read.
        private static double Finite(double number)
        {
            if (double.IsNaN(number) || double.IsInfinity(number))
            {
                throw new ArgumentException("a goal holds " + number.ToString(CultureInfo.InvariantCulture) + ", which is no number");
            }
            return number;
        }

        private static string Compact(JObject operation)
        {
            return operation.ToString(Newtonsoft.Json.Formatting.None);
        }
    }
}
