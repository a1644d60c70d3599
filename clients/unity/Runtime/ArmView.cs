using System;
using System.Collections;
using System.Collections.Generic;
using UnityEngine;
using UnityEngine.Networking;
using UnityEngine.Rendering;

namespace Armbridge
{
    /// <summary>
    /// Shows the server's arm below this object and moves it as the arm moves: links and meshes come from the server, so
    /// that the project needs no assets of it. Add a token's query to the URL if the server requires one.
    /// </summary>
    [AddComponentMenu("armbridge/Arm View")]
    [RequireComponent(typeof(ArmBridge))]
    public sealed class ArmView : MonoBehaviour
    {
        private const int TimeoutS = 30;

        [Tooltip("Material of the links; Unity's own is used if this is empty.")]
        [SerializeField] private Material material;

        private readonly Dictionary<string, Action<double>> positions = new Dictionary<string, Action<double>>();
        private ArmBridge bridge;

        /// <summary>The links by their names, once they have come.</summary>
        public IReadOnlyDictionary<string, Transform> Links { get; private set; } = new Dictionary<string, Transform>();

        private void OnEnable()
        {
            bridge = GetComponent<ArmBridge>();
            bridge.JointsReceived += Move;
            if (Links.Count == 0)
            {
                StartCoroutine(Load());
            }
        }

        private void OnDisable()
        {
            bridge.JointsReceived -= Move;
        }

        private void Move(JointPositions measured)
        {
            for (int i = 0; i < measured.Names.Length; ++i)
            {
                if (positions.TryGetValue(measured.Names[i], out Action<double> set))
                {
                    set(measured.PositionsRad[i]);
                }
            }
        }

        private IEnumerator Load()
        {
            // The port that speaks rosbridge serves the files by HTTP: ws is http, wss is https.
            var url = new Uri(new Uri("http" + bridge.Url.Substring(2)), "robot/description.urdf");
            UnityWebRequest request = Request(url.AbsoluteUri);
            yield return request.SendWebRequest();
            if (!Came(request))
            {
                yield break;
            }
            RobotModel model = RobotModel.Parse(request.downloadHandler.text, url);
            Build(model);
            var meshes = new Dictionary<string, float[]>();
            foreach (Visual visual in model.Visuals)
            {
                if (visual.Shape != Shape.Mesh)
                {
                    Place(visual, Primitive(visual));
                    continue;
                }
                if (!meshes.ContainsKey(visual.Mesh))
                {
                    UnityWebRequest file = Request(visual.Mesh);
                    yield return file.SendWebRequest();
                    meshes[visual.Mesh] = Came(file) ? Corners(file) : null;
                }
                if (meshes[visual.Mesh] != null)
                {
                    Place(visual, Meshed(visual, meshes[visual.Mesh]));
                }
            }
        }

        private UnityWebRequest Request(string url)
        {
            UnityWebRequest request = UnityWebRequest.Get(url);
            request.timeout = TimeoutS;
            if (bridge.Token.Length > 0)
            {
                request.SetRequestHeader("Authorization", "Bearer " + bridge.Token);
            }
            return request;
        }

        private bool Came(UnityWebRequest request)
        {
            if (request.result == UnityWebRequest.Result.Success)
            {
                return true;
            }
            Debug.LogWarning("armbridge: " + request.url + ": " + request.error, this);
            return false;
        }

        private float[] Corners(UnityWebRequest file)
        {
            try
            {
                return Stl.Parse(file.downloadHandler.data);
            }
            catch (FormatException error)
            {
                Debug.LogWarning("armbridge: " + file.url + ": " + error.Message, this);
                return null;
            }
        }

        private void Build(RobotModel model)
        {
            var links = new Dictionary<string, Transform>();
            foreach (string name in model.Links)
            {
                links[name] = new GameObject(name).transform;
                links[name].SetParent(transform, false);
            }
            foreach (Joint joint in model.Joints)
            {
                Transform child = links[joint.Child];
                child.SetParent(links[joint.Parent], false);
                Vector3 position = Unity(Coordinates.UnityFromRos(joint.Position));
                Quaternion rotation = Unity(Coordinates.UnityFromRos(joint.Rotation));
                Vector3 axis = Unity(Coordinates.UnityFromRos(joint.Axis));
                child.localPosition = position;
                child.localRotation = rotation;
                if (joint.Turns)
                {
                    positions[joint.Name] = angle => child.localRotation =
                        rotation * Quaternion.AngleAxis((float)Coordinates.UnityDegreesFromRos(angle), axis);
                }
                else if (joint.Slides)
                {
                    positions[joint.Name] = way => child.localPosition = position + rotation * axis * (float)way;
                }
            }
            Links = links;
        }

        // Unity's cylinder stands along y, which is ROS's z, and is 2 m high.
        private static GameObject Primitive(Visual visual)
        {
            PrimitiveType type = visual.Shape == Shape.Box ? PrimitiveType.Cube
                : visual.Shape == Shape.Cylinder ? PrimitiveType.Cylinder : PrimitiveType.Sphere;
            GameObject shown = GameObject.CreatePrimitive(type);
            // Its collider would meet the game's own objects.
            Destroy(shown.GetComponent<Collider>());
            float height = (float)visual.Size.Z / (visual.Shape == Shape.Cylinder ? 2f : 1f);
            shown.transform.localScale = new Vector3((float)visual.Size.Y, height, (float)visual.Size.X);
            return shown;
        }

        private static GameObject Meshed(Visual visual, float[] corners)
        {
            int count = corners.Length / 3;
            var vertices = new Vector3[count];
            var triangles = new int[count];
            for (int i = 0; i < count; ++i)
            {
                var corner = new Triple(
                    corners[3 * i] * visual.Size.X, corners[3 * i + 1] * visual.Size.Y, corners[3 * i + 2] * visual.Size.Z);
                vertices[i] = Unity(Coordinates.UnityFromRos(corner));
                // One mirrored axis turns the triangles inside out: their corners are taken in the other order.
                triangles[i] = i - i % 3 + 2 - i % 3;
            }
            var mesh = new Mesh { indexFormat = IndexFormat.UInt32, vertices = vertices, triangles = triangles };
            mesh.RecalculateNormals();
            var shown = new GameObject("mesh", typeof(MeshFilter), typeof(MeshRenderer));
            shown.GetComponent<MeshFilter>().sharedMesh = mesh;
            return shown;
        }

        private void Place(Visual visual, GameObject shown)
        {
            shown.name = visual.Link + " visual";
            shown.transform.SetParent(Links[visual.Link], false);
            shown.transform.localPosition = Unity(Coordinates.UnityFromRos(visual.Position));
            shown.transform.localRotation = Unity(Coordinates.UnityFromRos(visual.Rotation));
            Shader shader = Shader.Find("Universal Render Pipeline/Lit");
            Material own = material != null ? new Material(material) : new Material(shader != null ? shader : Shader.Find("Standard"));
            own.color = new Color((float)visual.Color[0], (float)visual.Color[1], (float)visual.Color[2], (float)visual.Color[3]);
            shown.GetComponent<MeshRenderer>().sharedMaterial = own;
        }

        private static Vector3 Unity(Triple triple)
        {
            return new Vector3((float)triple.X, (float)triple.Y, (float)triple.Z);
        }

        private static Quaternion Unity(Rotation rotation)
        {
            return new Quaternion((float)rotation.X, (float)rotation.Y, (float)rotation.Z, (float)rotation.W);
        }
    }
}
