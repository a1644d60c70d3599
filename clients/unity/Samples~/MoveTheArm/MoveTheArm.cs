using Armbridge;
using UnityEngine;

/// <summary>
/// Makes its scene by itself: add it to an empty object of an empty scene and press Play. 1 and 2 move to named targets,
/// O and C open and close the gripper, Space stops.
/// </summary>
public sealed class MoveTheArm : MonoBehaviour
{
    [SerializeField] private string url = "ws://127.0.0.1:9090";

    private ArmBridge arm;
    private string sentence = "1: ready   2: rest   O, C: gripper   Space: STOP";

    private void Awake()
    {
        var camera = new GameObject("Camera", typeof(Camera)).transform;
        camera.position = new Vector3(0.5f, 0.4f, 0.6f);
        camera.LookAt(new Vector3(0f, 0.15f, 0.15f));
        var light = new GameObject("Light", typeof(Light)).GetComponent<Light>();
        light.type = LightType.Directional;
        light.transform.rotation = Quaternion.Euler(50f, -30f, 0f);

        var robot = new GameObject("Arm");
        robot.SetActive(false);
        arm = robot.AddComponent<ArmBridge>();
        arm.Url = url;
        arm.GoalEnded.AddListener((code, message) => sentence = code + ": " + message);
        arm.GripperEnded.AddListener((done, message) => sentence = message);
        robot.AddComponent<ArmView>();
        robot.SetActive(true);
    }

    private void Update()
    {
        if (Input.GetKeyDown(KeyCode.Space))
        {
            arm.Stop();
        }
        else if (Input.GetKeyDown(KeyCode.Alpha1))
        {
            arm.MoveToNamed("ready");
        }
        else if (Input.GetKeyDown(KeyCode.Alpha2))
        {
            arm.MoveToNamed("rest");
        }
        else if (Input.GetKeyDown(KeyCode.O))
        {
            arm.MoveGripper(1.0, 0.0);
        }
        else if (Input.GetKeyDown(KeyCode.C))
        {
            arm.MoveGripper(0.0, 0.0);
        }
    }

    private void OnGUI()
    {
        GUI.Label(new Rect(10, 10, Screen.width - 20, 60), arm.IsConnected ? sentence : "not connected to " + url);
    }
}
