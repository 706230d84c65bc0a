using System;
using UnityEngine;

namespace Roomfix
{
    // What the server answers. JsonUtility fills the fields by their names in the JSON; it has no null for objects, so
    // that a pose which is not known has the quaternion (0, 0, 0, 0).

    /// <summary>A point in metres.</summary>
    [Serializable]
    public struct Position
    {
        public float x, y, z;

        public static Position Of(Vector3 v) { return new Position { x = v.x, y = v.y, z = v.z }; }
        public Vector3 ToVector3() { return new Vector3(x, y, z); }
    }

    /// <summary>A unit quaternion, scalar last.</summary>
    [Serializable]
    public struct Rotation
    {
        public float x, y, z, w;

        public static Rotation Of(Quaternion q) { return new Rotation { x = q.x, y = q.y, z = q.z, w = q.w }; }
        public Quaternion ToQuaternion() { return new Quaternion(x, y, z, w); }
    }

    /// <summary>A pose; that of an answer is world_from_camera.</summary>
    [Serializable]
    public struct RoomfixPose
    {
        public Position position;
        public Rotation quaternion;

        public bool IsKnown
        {
            get { return quaternion.x != 0 || quaternion.y != 0 || quaternion.z != 0 || quaternion.w != 0; }
        }
    }

    /// <summary>A point on the floor plan: metres, and degrees counter-clockwise from plan x.</summary>
    [Serializable]
    public class Plan
    {
        public float x, y, heading_deg;
        public string area, nearest_landmark;
    }

    /// <summary>One sigma.</summary>
    [Serializable]
    public class Accuracy
    {
        public float position_m, orientation_deg;
    }

    /// <summary>Where the camera is, or the reason why that can't be said.</summary>
    [Serializable]
    public class LocateResult
    {
        public bool located;
        public string reason, floor;
        public RoomfixPose pose, session_from_world;
        public Plan plan;
        public Accuracy accuracy;
        public float confidence;
        public string[] hints;
    }

    /// <summary>What the server refused: its status, a stable code, and a sentence that says what to change.</summary>
    [Serializable]
    public class Problem
    {
        public int status;
        public string code, detail;
    }

    public class RoomfixException : Exception
    {
        public readonly int Status;
        public readonly string Code;

        public RoomfixException(Problem problem) : base(problem.detail)
        {
            Status = problem.status;
            Code = problem.code;
        }
    }
}
