using System;
using System.Globalization;
using Newtonsoft.Json;
using Newtonsoft.Json.Linq;

namespace Armbridge
{
    /// <summary>Names of the joints and their measured positions [rad].</summary>
    public sealed class JointPositions
    {
        public JointPositions(string[] names, double[] positionsRad)
        {
            Names = names;
            PositionsRad = positionsRad;
        }

        public string[] Names { get; private set; }

        public double[] PositionsRad { get; private set; }
    }

    /// <summary>
    /// A client of an armbridge server. Call <see cref="Poll"/> once a frame: events are raised within it. A goal replaces
    /// the one before; its end is reported once, by <see cref="GoalEnded"/>.
    /// </summary>
    public sealed class ArmClient : IDisposable
    {
        /// <summary>MoveIt's COMMUNICATION_FAILURE: the connection was lost before a goal's end came.</summary>
        public const int ConnectionLost = -25;

        private readonly Connection connection;
        private int goals;

        // What identifies the latest goal in its statuses: its stamp, or the topic of a goal without a header.
        private string goalStamp = "";
        private string goalTopic = "";
        private string gripperId = "";

        // Named goals whose end has not come: a goal that another one replaces ends as well, on the same topic.
        private int namedWaiting;

        public ArmClient(string url, string token)
        {
            connection = new Connection(url, token, Frames.Setup());
        }

        /// <summary>Measured positions, 25 times a second.</summary>
        public event Action<JointPositions> JointsReceived;

        /// <summary>The end of the latest goal: MoveIt's error code, 1 for success, and a sentence.</summary>
        public event Action<int, string> GoalEnded;

        /// <summary>The end of the latest gripper command: true if it reached its place or holds something, and a sentence.</summary>
        public event Action<bool, string> GripperEnded;

        /// <summary>What a person should read: the connection's state, and what the server refused.</summary>
        public event Action<string> Reported;

        public bool IsConnected
        {
            get { return connection.IsOpen; }
        }

        /// <summary>Moves to a named target, such as "ready". Returns false while not connected, as the others do.</summary>
        public bool MoveToNamed(string target)
        {
            if (!connection.Send(Frames.Named(target)))
            {
                return false;
            }
            goalStamp = "";
            goalTopic = Frames.NamedTopic;
            ++namedWaiting;
            return true;
        }

        /// <summary>Moves some joints [rad]; the others stay.</summary>
        public bool MoveJoints(string[] names, double[] positionsRad)
        {
            var stamp = new GoalStamp(DateTimeOffset.UtcNow, ++goals);
            return Begun(stamp, connection.Send(Frames.Joints(stamp, names, positionsRad)));
        }

        /// <summary>Moves the tip to a pose relative to the arm's base, in ROS's axes [m].</summary>
        public bool MoveTip(Triple position, Rotation? rotation)
        {
            var stamp = new GoalStamp(DateTimeOffset.UtcNow, ++goals);
            return Begun(stamp, connection.Send(Frames.Pose(stamp, position, rotation)));
        }

        /// <summary>Moves the gripper's joint [rad], with at most this share of its torque (0: the server's own).</summary>
        public bool MoveGripper(double positionRad, double maxEffort)
        {
            string id = "gripper " + ++goals;
            if (!connection.Send(Frames.Gripper(id, positionRad, maxEffort)))
            {
                return false;
            }
            gripperId = id;
            return true;
        }

        /// <summary>Stops the arm along its path and ends all goals.</summary>
        public bool Stop()
        {
            return connection.Send(Frames.Stop());
        }

        /// <summary>Raises the events of all frames that have come.</summary>
        public void Poll()
        {
            while (connection.TryTakeReport(out string report))
            {
                Reported?.Invoke(report);
            }
            while (connection.TryTake(out string frame))
            {
                try
                {
                    Handle(JObject.Parse(frame));
                }
                catch (JsonException error)
                {
                    Reported?.Invoke("a frame could not be read: " + error.Message);
                }
            }
            if (!connection.IsOpen)
            {
                GiveUpAnswers();
            }
        }

        public void Dispose()
        {
            connection.Dispose();
        }

        private bool Begun(GoalStamp stamp, bool sent)
        {
            if (sent)
            {
                goalStamp = stamp.ToString();
                goalTopic = "";
            }
            return sent;
        }

        private void Handle(JObject operation)
        {
            string op = (string)operation["op"];
            string topic = (string)operation["topic"];
            if (op == "status")
            {
                Reported?.Invoke("refused: " + (string)operation["msg"]);
            }
            else if (op == "action_result" && (string)operation["id"] == gripperId)
            {
                HandleGripper(operation);
            }
            else if (op == "publish" && topic == Frames.JointStatesTopic)
            {
                JToken message = operation["msg"];
                JointsReceived?.Invoke(
                    new JointPositions(message["name"].ToObject<string[]>(), message["position"].ToObject<double[]>()));
            }
            else if (op == "publish" && topic == Frames.StatusTopic)
            {
                HandleStatus(operation["msg"]);
            }
        }

        private void HandleStatus(JToken status)
        {
            if (ValueOf(status, "state") != "done")
            {
                return;
            }
            bool named = (string)status["name"] == Frames.NamedTopic;
            namedWaiting -= named && namedWaiting > 0 ? 1 : 0;
            if (goalStamp.Length > 0 ? ValueOf(status, "stamp") == goalStamp : named && goalTopic.Length > 0 && namedWaiting == 0)
            {
                EndGoal(int.Parse(ValueOf(status, "code"), CultureInfo.InvariantCulture), (string)status["message"]);
            }
        }

        private void EndGoal(int code, string message)
        {
            goalStamp = "";
            goalTopic = "";
            GoalEnded?.Invoke(code, message);
        }

        // What was asked on a lost connection is not answered on the next one. The arm may still be moving.
        private void GiveUpAnswers()
        {
            namedWaiting = 0;
            if (goalStamp.Length > 0 || goalTopic.Length > 0)
            {
                EndGoal(ConnectionLost, "the connection was lost before the goal's end came; the arm may still be moving");
            }
            if (gripperId.Length > 0)
            {
                gripperId = "";
                GripperEnded?.Invoke(false, "the connection was lost before the gripper's end came");
            }
        }

        private void HandleGripper(JObject operation)
        {
            gripperId = "";
            // Of a goal that was refused, values is a sentence.
            var values = operation["values"] as JObject;
            if (values == null)
            {
                GripperEnded?.Invoke(false, (string)operation["values"]);
                return;
            }
            bool reached = (bool)values["reached_goal"];
            bool stalled = (bool)values["stalled"];
            GripperEnded?.Invoke(reached || stalled, reached ? "the gripper is there" : stalled ? "the gripper holds something" : "the gripper did not get there");
        }

        private static string ValueOf(JToken status, string key)
        {
            foreach (JToken pair in status["values"])
            {
                if ((string)pair["key"] == key)
                {
                    return (string)pair["value"];
                }
            }
            return "";
        }
    }
}
