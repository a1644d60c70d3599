// The declarations of UnityEngine that the package uses, so that it compiles without Unity. Nothing here does anything.
using System;
using System.Collections;

namespace UnityEngine
{
    public class Object
    {
        public string name;
        public static void Destroy(Object thing) { }
    }
    public class Component : Object
    {
        public Transform transform;
        public GameObject gameObject;
        public T GetComponent<T>() { return default(T); }
    }
    public class Behaviour : Component { public bool enabled; }
    public class MonoBehaviour : Behaviour { public Coroutine StartCoroutine(IEnumerator routine) { return null; } }
    public class Coroutine { }
    public class GameObject : Object
    {
        public Transform transform;
        public GameObject(string name, params Type[] components) { }
        public T GetComponent<T>() { return default(T); }
        public T AddComponent<T>() where T : Component { return null; }
        public void SetActive(bool value) { }
        public static GameObject CreatePrimitive(PrimitiveType type) { return null; }
    }
    public enum PrimitiveType { Sphere, Cylinder, Cube }
    public class Collider : Component { }
    public class Transform : Component
    {
        public Vector3 position;
        public Vector3 localPosition;
        public Vector3 localScale;
        public Quaternion rotation;
        public Quaternion localRotation;
        public void SetParent(Transform parent, bool worldPositionStays) { }
        public void LookAt(Vector3 point) { }
    }
    public struct Vector3
    {
        public float x, y, z;
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
        public static Vector3 operator +(Vector3 a, Vector3 b) { return a; }
        public static Vector3 operator *(Vector3 a, float b) { return a; }
    }
    public struct Quaternion
    {
        public float x, y, z, w;
        public Quaternion(float x, float y, float z, float w) { this.x = x; this.y = y; this.z = z; this.w = w; }
        public static Quaternion AngleAxis(float angle, Vector3 axis) { return default(Quaternion); }
        public static Quaternion Euler(float x, float y, float z) { return default(Quaternion); }
        public static Quaternion operator *(Quaternion a, Quaternion b) { return a; }
        public static Vector3 operator *(Quaternion a, Vector3 b) { return b; }
    }
    public struct Color { public Color(float r, float g, float b, float a) { } }
    public struct Rect { public Rect(float x, float y, float width, float height) { } }
    public class Mesh : Object
    {
        public Rendering.IndexFormat indexFormat;
        public Vector3[] vertices;
        public int[] triangles;
        public void RecalculateNormals() { }
    }
    public class MeshFilter : Component { public Mesh sharedMesh; }
    public class MeshRenderer : Component { public Material sharedMaterial; }
    public class Shader : Object { public static Shader Find(string name) { return null; } }
    public class Material : Object
    {
        public Color color;
        public Material(Shader shader) { }
        public Material(Material source) { }
    }
    public class Camera : Behaviour { }
    public class Light : Behaviour { public LightType type; }
    public enum LightType { Directional }
    public enum KeyCode { Space, Alpha1, Alpha2, O, C }
    public static class Input { public static bool GetKeyDown(KeyCode key) { return false; } }
    public static class GUI { public static void Label(Rect position, string text) { } }
    public static class Screen { public static int width; }
    public static class Debug
    {
        public static void Log(object message, Object context) { }
        public static void LogWarning(object message, Object context) { }
    }
    [AttributeUsage(AttributeTargets.Field)] public sealed class SerializeField : Attribute { }
    [AttributeUsage(AttributeTargets.Field)] public sealed class TooltipAttribute : Attribute { public TooltipAttribute(string tooltip) { } }
    [AttributeUsage(AttributeTargets.Class)] public sealed class AddComponentMenu : Attribute { public AddComponentMenu(string name) { } }
    [AttributeUsage(AttributeTargets.Class)] public sealed class RequireComponent : Attribute { public RequireComponent(Type type) { } }
}

namespace UnityEngine.Rendering
{
    public enum IndexFormat { UInt16, UInt32 }
}

namespace UnityEngine.Events
{
    public delegate void UnityAction<T0, T1>(T0 first, T1 second);
    public class UnityEvent<T0, T1>
    {
        public void Invoke(T0 first, T1 second) { }
        public void AddListener(UnityAction<T0, T1> call) { }
    }
}

namespace UnityEngine.Networking
{
    public class DownloadHandler { public string text; public byte[] data; }
    public class UnityWebRequestAsyncOperation { }
    public class UnityWebRequest
    {
        public enum Result { InProgress, Success }
        public string url;
        public string error;
        public int timeout;
        public Result result;
        public DownloadHandler downloadHandler;
        public static UnityWebRequest Get(string url) { return null; }
        public void SetRequestHeader(string name, string value) { }
        public UnityWebRequestAsyncOperation SendWebRequest() { return null; }
    }
}
