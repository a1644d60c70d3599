using System;
using System.Collections.Generic;
using System.Globalization;
using System.Xml;

namespace Armbridge
{
    public enum Shape
    {
        Box,
        Cylinder,
        Sphere,
        Mesh,
    }

    /// <summary>A shape of a link, placed in the link's frame.</summary>
    public sealed class Visual
    {
        public string Link;
        public Shape Shape;

        /// <summary>URL of a mesh on the server.</summary>
        public string Mesh;

        /// <summary>Edges of a box, diameters and length of a cylinder along z, diameters of a sphere [m]; scale of a mesh.</summary>
        public Triple Size;
        public Triple Position;
        public Rotation Rotation;

        /// <summary>Red, green, blue and opacity, each 0 to 1.</summary>
        public double[] Color;
    }

    /// <summary>A joint of a URDF: its child link stands in its parent link at the origin, turned or shifted by its position.</summary>
    public sealed class Joint
    {
        public string Name;
        public string Parent;
        public string Child;
        public bool Turns;
        public bool Slides;
        public Triple Position;
        public Rotation Rotation;
        public Triple Axis;
    }

    /// <summary>What a URDF shows: links with meshes, and joints. Frames are ROS's, in metres and radians.</summary>
    public sealed class RobotModel
    {
        public readonly List<string> Links = new List<string>();
        public readonly List<Joint> Joints = new List<Joint>();
        public readonly List<Visual> Visuals = new List<Visual>();

        /// <param name="urdf">text of the URDF.</param>
        /// <param name="url">URL of the URDF; the names of its meshes are relative to it.</param>
        /// <exception cref="FormatException">an attribute is missing or is no number.</exception>
        public static RobotModel Parse(string urdf, Uri url)
        {
            var document = new XmlDocument { XmlResolver = null };
            document.LoadXml(urdf);
            var model = new RobotModel();
            var colors = new Dictionary<string, double[]>();
            foreach (XmlElement material in document.SelectNodes("//material[color]"))
            {
                colors[material.GetAttribute("name")] = Numbers((XmlElement)material.SelectSingleNode("color"), "rgba", 4, "1 1 1 1");
            }
            foreach (XmlElement link in document.SelectNodes("/robot/link"))
            {
                string name = link.GetAttribute("name");
                model.Links.Add(name);
                foreach (XmlElement visual in link.SelectNodes("visual"))
                {
                    var origin = (XmlElement)visual.SelectSingleNode("origin");
                    var material = (XmlElement)visual.SelectSingleNode("material");
                    double[] color;
                    if (material == null || !colors.TryGetValue(material.GetAttribute("name"), out color))
                    {
                        color = new[] { 0.8, 0.8, 0.8, 1.0 };
                    }
                    var shown = new Visual
                    {
                        Link = name,
                        Position = Vector(origin, "xyz", "0 0 0"),
                        Rotation = Turned(origin),
                        Color = color,
                    };
                    SetShape(shown, (XmlElement)visual.SelectSingleNode("geometry/*"), url);
                    model.Visuals.Add(shown);
                }
            }
            foreach (XmlElement joint in document.SelectNodes("/robot/joint"))
            {
                string type = joint.GetAttribute("type");
                var origin = (XmlElement)joint.SelectSingleNode("origin");
                model.Joints.Add(new Joint
                {
                    Name = joint.GetAttribute("name"),
                    Parent = ((XmlElement)joint.SelectSingleNode("parent"))?.GetAttribute("link") ?? throw Missing(joint, "parent"),
                    Child = ((XmlElement)joint.SelectSingleNode("child"))?.GetAttribute("link") ?? throw Missing(joint, "child"),
                    Turns = type == "revolute" || type == "continuous",
                    Slides = type == "prismatic",
                    Position = Vector(origin, "xyz", "0 0 0"),
                    Rotation = Turned(origin),
                    Axis = Vector((XmlElement)joint.SelectSingleNode("axis"), "xyz", "1 0 0"),
                });
            }
            return model;
        }

        private static void SetShape(Visual visual, XmlElement shape, Uri url)
        {
            switch (shape?.Name)
            {
                case "box":
                    visual.Shape = Shape.Box;
                    visual.Size = Vector(shape, "size", "");
                    break;
                case "cylinder":
                    visual.Shape = Shape.Cylinder;
                    double diameter = 2 * Numbers(shape, "radius", 1, "")[0];
                    visual.Size = new Triple(diameter, diameter, Numbers(shape, "length", 1, "")[0]);
                    break;
                case "sphere":
                    visual.Shape = Shape.Sphere;
                    double width = 2 * Numbers(shape, "radius", 1, "")[0];
                    visual.Size = new Triple(width, width, width);
                    break;
                case "mesh":
                    visual.Shape = Shape.Mesh;
                    visual.Mesh = MeshUrl(shape.GetAttribute("filename"), url);
                    visual.Size = Vector(shape, "scale", "1 1 1");
                    break;
                default:
                    throw new FormatException("link " + visual.Link + " has a visual without a shape");
            }
        }

        // The server has the meshes of a package in the folder of its name.
        private static string MeshUrl(string file, Uri url)
        {
            const string Package = "package://";
            return new Uri(url, file.StartsWith(Package, StringComparison.Ordinal) ? file.Substring(Package.Length) : file).AbsoluteUri;
        }

        private static Rotation Turned(XmlElement origin)
        {
            Triple angles = Vector(origin, "rpy", "0 0 0");
            return Rotation.FromRollPitchYaw(angles.X, angles.Y, angles.Z);
        }

        private static Triple Vector(XmlElement element, string attribute, string missing)
        {
            double[] numbers = Numbers(element, attribute, 3, missing);
            return new Triple(numbers[0], numbers[1], numbers[2]);
        }

        private static double[] Numbers(XmlElement element, string attribute, int count, string missing)
        {
            string text = element != null && element.HasAttribute(attribute) ? element.GetAttribute(attribute) : missing;
            string[] words = text.Split(new[] { ' ', '\t', '\n', '\r' }, StringSplitOptions.RemoveEmptyEntries);
            if (words.Length != count)
            {
                throw new FormatException("\"" + attribute + "\" has " + words.Length + " numbers in place of " + count + ": " + text);
            }
            return Array.ConvertAll(words, word => double.Parse(word, CultureInfo.InvariantCulture));
        }

        private static FormatException Missing(XmlElement joint, string what)
        {
            return new FormatException("joint " + joint.GetAttribute("name") + " has no " + what);
        }
    }

    /// <summary>Binary STL files, which hold triangles.</summary>
    public static class Stl
    {
        private const int Head = 84;
        private const int TriangleBytes = 50;

        /// <summary>The corners of the triangles: nine numbers each, counter-clockwise seen from outside.</summary>
        /// <exception cref="FormatException">the file is no binary STL, or is cut off.</exception>
        public static float[] Parse(byte[] file)
        {
            if (file.Length < Head)
            {
                throw new FormatException("an STL file of " + file.Length + " bytes; the head alone has " + Head);
            }
            long count = BitConverter.ToUInt32(file, Head - 4);
            if (file.Length < Head + count * TriangleBytes)
            {
                throw new FormatException(
                    "no binary STL: " + count + " triangles need " + (Head + count * TriangleBytes) + " bytes, the file has " + file.Length);
            }
            var corners = new float[count * 9];
            for (int triangle = 0; triangle < count; ++triangle)
            {
                // Each begins with its normal, which the corners give as well.
                Buffer.BlockCopy(file, Head + triangle * TriangleBytes + 12, corners, triangle * 36, 36);
            }
            return corners;
        }
    }
}
