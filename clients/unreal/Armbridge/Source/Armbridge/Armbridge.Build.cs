using UnrealBuildTool;

public class Armbridge : ModuleRules
{
	public Armbridge(ReadOnlyTargetRules Target) : base(Target)
	{
		PCHUsage = PCHUsageMode.UseExplicitOrSharedPCHs;
		PublicDependencyModuleNames.AddRange(new string[] { "Core", "CoreUObject", "Engine" });
		PrivateDependencyModuleNames.AddRange(new string[] { "HTTP", "ProceduralMeshComponent", "RapidJSON", "WebSockets", "XmlParser" });
	}
}
