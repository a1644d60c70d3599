using System;
using UnityEngine;
using UnityEngine.Events;

namespace Armbridge
{
    /// <summary>Moves the arm of a server. Events come on Unity's main thread.</summary>
    [AddComponentMenu("armbridge/Arm Bridge")]
    public sealed class ArmBridge : MonoBehaviour
    {
        [Serializable] public sealed class GoalEvent : UnityEvent<int, string> { }
        [Serializable] public sealed class GripperEvent : UnityEvent<bool, string> { }

        [SerializeField] private string url = "ws://127.0.0.1:9090";

        [Tooltip("Authentication token; empty if the server requires none.")]
        [SerializeField] private string token = "";

        [Tooltip("The end of the latest goal: MoveIt's error code, 1 for success, and a sentence.")]
        [SerializeField] private GoalEvent goalEnded = new GoalEvent();

        [Tooltip("The end of the latest gripper command.")]
        [SerializeField] private GripperEvent gripperEnded = new GripperEvent();

        private ArmClient client;

        /// <summary>Measured positions, 25 times a second.</summary>
        public event Action<JointPositions> JointsReceived;

        public string Url
        {
            get { return url; }
            set { url = value; }
        }

        public string Token
        {
            get { return token; }
            set { token = value; }
        }

        public GoalEvent GoalEnded
        {
            get { return goalEnded; }
        }

        public GripperEvent GripperEnded
        {
            get { return gripperEnded; }
        }

        public bool IsConnected
        {
            get { return client != null && client.IsConnected; }
        }

        /// <summary>Moves to a named target, such as "ready". Returns false while not connected, as the others do.</summary>
        public bool MoveToNamed(string target)
        {
            return client != null && client.MoveToNamed(target);
        }

        /// <summary>Moves some joints [rad]; the others stay.</summary>
        public bool MoveJoints(string[] names, double[] positionsRad)
        {
            return client != null && client.MoveJoints(names, positionsRad);
        }

        /// <summary>Moves the tip to a point relative to the arm's base, in Unity's axes [m].</summary>
        public bool MoveTip(Vector3 position)
        {
            return client != null && client.MoveTip(Ros(position), null);
        }

        /// <summary>Moves the tip to a pose relative to the arm's base; an SO-101's five joints cannot reach each one.</summary>
        public bool MoveTip(Vector3 position, Quaternion rotation)
        {
            var turned = Coordinates.RosFromUnity(new Rotation(rotation.x, rotation.y, rotation.z, rotation.w));
            return client != null && client.MoveTip(Ros(position), turned);
        }

        /// <summary>Moves the gripper's joint [rad], with at most this share of its torque (0: the server's own).</summary>
        public bool MoveGripper(double positionRad, double maxEffort)
        {
            return client != null && client.MoveGripper(positionRad, maxEffort);
        }

        /// <summary>Stops the arm along its path and ends all goals.</summary>
        public bool Stop()
        {
            return client != null && client.Stop();
        }

        private void OnEnable()
        {
            client = new ArmClient(url, token);
            client.JointsReceived += positions => JointsReceived?.Invoke(positions);
            client.GoalEnded += (code, message) => goalEnded.Invoke(code, message);
            client.GripperEnded += (done, message) => gripperEnded.Invoke(done, message);
            client.Reported += sentence => Debug.Log("armbridge: " + sentence, this);
        }

        private void Update()
        {
            client.Poll();
        }

        private void OnDisable()
        {
            client.Dispose();
            client = null;
        }

        private static Triple Ros(Vector3 position)
        {
            return Coordinates.RosFromUnity(new Triple(position.x, position.y, position.z));
        }
    }
}
