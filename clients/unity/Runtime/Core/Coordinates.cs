using System;

namespace Armbridge
{
    /// <summary>A position or a direction of three numbers, in the frame that its user names.</summary>
    public readonly struct Triple
    {
        public readonly double X;
        public readonly double Y;
        public readonly double Z;

        public Triple(double x, double y, double z)
        {
            X = x;
            Y = y;
            Z = z;
        }
    }

    /// <summary>A rotation as a unit quaternion, with w last as in Unity and ROS.</summary>
    public readonly struct Rotation
    {
        public readonly double X;
        public readonly double Y;
        public readonly double Z;
        public readonly double W;

        public Rotation(double x, double y, double z, double w)
        {
            X = x;
            Y = y;
            Z = z;
            W = w;
        }

        /// <summary>The rotation by roll, pitch and yaw [rad] about fixed axes, as URDF writes it (rpy).</summary>
        public static Rotation FromRollPitchYaw(double roll, double pitch, double yaw)
        {
            double cr = Math.Cos(roll / 2), sr = Math.Sin(roll / 2);
            double cp = Math.Cos(pitch / 2), sp = Math.Sin(pitch / 2);
            double cy = Math.Cos(yaw / 2), sy = Math.Sin(yaw / 2);
            return new Rotation(
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
                cr * cp * cy + sr * sp * sy);
        }
    }

    /// <summary>
    /// Unity is left-handed: x right, y up, z ahead. ROS (REP 103) is right-handed: x ahead, y left, z up. Both are in metres.
    /// </summary>
    public static class Coordinates
    {
        public static Triple RosFromUnity(Triple position)
        {
            return new Triple(position.Z, -position.X, position.Y);
        }

        public static Triple UnityFromRos(Triple position)
        {
            return new Triple(-position.Y, position.Z, position.X);
        }

        public static Rotation RosFromUnity(Rotation rotation)
        {
            return new Rotation(-rotation.Z, rotation.X, -rotation.Y, rotation.W);
        }

        public static Rotation UnityFromRos(Rotation rotation)
        {
            return new Rotation(rotation.Y, -rotation.Z, -rotation.X, rotation.W);
        }

        /// <summary>An angle about a joint's axis [rad] in ROS, in Unity's degrees about the converted axis.</summary>
        public static double UnityDegreesFromRos(double angleRad)
        {
            return -angleRad * 180.0 / Math.PI;
        }
    }
}
