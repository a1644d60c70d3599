using System;
using System.Globalization;
using System.IO;
using System.Net;
using System.Threading;
using Armbridge;

/// <summary>Runs the engine-free part without Unity: each line of the input is a command, each event a line of the output.</summary>
public static class Driver
{
    public static int Main(string[] arguments)
    {
        CultureInfo.CurrentCulture = new CultureInfo("de-DE");
        if (arguments[0] == "numbers")
        {
            Numbers();
            return 0;
        }
        using (var arm = new ArmClient(arguments[0], arguments.Length > 1 ? arguments[1] : ""))
        {
            int joints = 0;
            arm.JointsReceived += positions =>
            {
                if (joints++ == 0)
                {
                    Print("joints", string.Join(" ", positions.Names));
                }
            };
            arm.GoalEnded += (code, message) => Print("goal", code + " " + message);
            arm.GripperEnded += (done, message) => Print("gripper", done + " " + message);
            arm.Reported += sentence => Print("report", sentence);
            var input = new Thread(() => Read(arm)) { IsBackground = true };
            input.Start();
            while (input.IsAlive)
            {
                lock (arm)
                {
                    arm.Poll();
                }
                Thread.Sleep(5);
            }
            return 0;
        }
    }

    private static void Read(ArmClient arm)
    {
        string line;
        while ((line = Console.ReadLine()) != null)
        {
            string[] words = line.Split(' ');
            lock (arm)
            {
                Print("sent", Run(arm, words).ToString());
            }
        }
    }

    private static bool Run(ArmClient arm, string[] words)
    {
        switch (words[0])
        {
            case "named": return arm.MoveToNamed(words[1]);
            case "joint": return arm.MoveJoints(new[] { words[1] }, new[] { Number(words[2]) });
            case "tip":
                var inUnity = new Triple(Number(words[1]), Number(words[2]), Number(words[3]));
                return arm.MoveTip(Coordinates.RosFromUnity(inUnity), null);
            case "gripper": return arm.MoveGripper(Number(words[1]), 0);
            case "stop": return arm.Stop();
            default: throw new ArgumentException(words[0]);
        }
    }

    /// <summary>Each line: a way of the coordinates and its numbers, or a URDF and a mesh by HTTP; answered by numbers.</summary>
    private static void Numbers()
    {
        string line;
        while ((line = Console.ReadLine()) != null)
        {
            string[] words = line.Split(' ');
            double[] n = words[0] == "robot" || words[0] == "stl" ? null : Array.ConvertAll(Tail(words), Number);
            switch (words[0])
            {
                case "position": Print(Coordinates.RosFromUnity(new Triple(n[0], n[1], n[2]))); break;
                case "position_back": Print(Coordinates.UnityFromRos(new Triple(n[0], n[1], n[2]))); break;
                case "rotation": Print(Coordinates.RosFromUnity(new Rotation(n[0], n[1], n[2], n[3]))); break;
                case "rotation_back": Print(Coordinates.UnityFromRos(new Rotation(n[0], n[1], n[2], n[3]))); break;
                case "rpy": Print(Rotation.FromRollPitchYaw(n[0], n[1], n[2])); break;
                case "setup":
                    foreach (string frame in Frames.Setup())
                    {
                        Print("send", frame);
                    }
                    break;
                case "delays":
                    TimeSpan delay = Connection.FirstDelay;
                    for (int i = 0; i < 7; ++i, delay = Connection.NextDelay(delay))
                    {
                        Print("delay", delay.TotalSeconds.ToString(CultureInfo.InvariantCulture));
                    }
                    break;
                case "robot": Robot(new Uri(words[1])); break;
                case "stl":
                    try
                    {
                        Print("corners", Stl.Parse(File.ReadAllBytes(words[1])).Length.ToString());
                    }
                    catch (FormatException error)
                    {
                        Print("error", error.Message);
                    }
                    break;
            }
        }
    }

    private static void Robot(Uri url)
    {
        using (var web = new WebClient())
        {
            RobotModel model = RobotModel.Parse(web.DownloadString(url), url);
            int moving = model.Joints.FindAll(joint => joint.Turns || joint.Slides).Count;
            Print("robot", model.Links.Count + " " + moving + " " + model.Visuals.Count);
            foreach (Visual visual in model.Visuals)
            {
                string mesh = visual.Shape == Shape.Mesh ? " " + Stl.Parse(web.DownloadData(visual.Mesh)).Length / 9 : "";
                Print("visual", FormattableString.Invariant($"{visual.Link} {visual.Shape} {visual.Size.X} {visual.Size.Y} {visual.Size.Z}{mesh}"));
            }
        }
    }

    private static string[] Tail(string[] words)
    {
        var tail = new string[words.Length - 1];
        Array.Copy(words, 1, tail, 0, tail.Length);
        return tail;
    }

    private static double Number(string word)
    {
        return double.Parse(word, CultureInfo.InvariantCulture);
    }

    private static void Print(Triple t)
    {
        Print("triple", FormattableString.Invariant($"{t.X:R} {t.Y:R} {t.Z:R}"));
    }

    private static void Print(Rotation r)
    {
        Print("rotation", FormattableString.Invariant($"{r.X:R} {r.Y:R} {r.Z:R} {r.W:R}"));
    }

    private static void Print(string kind, string rest)
    {
        Console.WriteLine(kind + " " + rest);
        Console.Out.Flush();
    }
}
